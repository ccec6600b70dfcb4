"""A drive behind lenses by a backbone of pinhole cameras, from windows to poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.kilometres.lenses import calibration_of
from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.backbones.undistorted import UndistortedPictures
from calm_edge.config import Config, merge
from calm_edge.estimator.localizer import Localizer
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.through_lens import ThroughLens
from calm_edge.kit import estimated
from calm_edge.types import SubmapWindow
from tests.bench.scripted.street_drive import street
from tests.drives import position_error, windows

N = 60
LENSES: tuple[Camera, Camera] = (
    Perspective(330.0, 330.0, 319.5, 99.5, 640, 200, (-0.25, 0.06)),
    Fisheye(340.0, 340.0, 319.5, 119.5, 640, 240, (0.02,)),
)


class Network(ScriptedBackbone):
    """Records the pictures that it is given."""

    def infer(self, images, hints):
        self.given = [np.array(image) for image in images]
        return super().infer(images, hints)


def lit(window: SubmapWindow) -> SubmapWindow:
    """The window with pictures of noise, of the cameras' sizes."""

    def eye(keyframes, lens):
        shape = (lens.height, lens.width, 3)
        image = np.random.default_rng(lens.height).integers(0, 255, shape).astype(np.uint8)
        return tuple(replace(k, frame=replace(k.frame, image=image)) for k in keyframes)

    primary, assistant = (
        eye(keyframes, lens)
        for keyframes, lens in zip((window.primary, window.assistant), LENSES, strict=True)
    )
    return replace(window, primary=primary, assistant=assistant)


@pytest.fixture(scope="module")
def scene():
    return replace(street(N, turn=0.02), cameras=LENSES)


def driven(scene, known: bool, errors: ScriptedErrors):
    """Localizer, updates and network after the drive."""
    spacing = float(np.linalg.norm(scene.T_p_a[:3, 3]))
    config = merge(Config(), {"scale": {"spacing_m": spacing}, "loops": {"enabled": False}})
    if known:
        config = replace(config, calibration=calibration_of(LENSES))
    network = Network(scene, errors)
    localizer = Localizer(config, UndistortedPictures(network))
    updates = [localizer.process(lit(window)) for window in windows(N)]
    return localizer, [u for u in updates if u is not None], network


EXACT = ScriptedErrors(coupled=True)


@pytest.fixture(scope="module")
def calibrated(scene):
    return driven(scene, True, EXACT)


def test_a_calibration_gives_the_network_undistorted_pictures(calibrated, scene):
    _, updates, network = calibrated
    taken = [k.frame.bgr() for k in lit(windows(N)[-1]).keyframes()]
    assert len(network.given) == len(taken)
    for given, image in zip(network.given, taken, strict=True):
        assert given.shape == image.shape and not np.array_equal(given, image)
    lines = [line for update in updates for line in update.notices]
    assert sum("are undistorted, by the lens of the calibration" in line for line in lines) == 1


def test_the_path_is_the_true_one(calibrated, scene):
    localizer, _, _ = calibrated
    error = position_error(localizer.finish().T_w_c, scene.T_w_p)
    assert error.max() < 0.05
    for submap in localizer.submaps:
        focals = [submap.cameras[view].fx for view in (0, submap.n_primary)]
        assert focals == pytest.approx([lens.fx for lens in LENSES], rel=2e-3)


def test_nothing_that_leaves_has_a_pinhole_camera_with_pixels_as_taken(calibrated, scene):
    _, updates, _ = calibrated
    for update in updates:
        submap, marks = update.submap, update.prediction.landmarks
        for cameras in (submap.cameras, submap.cameras_raw, update.prediction.cameras):
            assert all(type(camera) is ThroughLens for camera in cameras)
        # landmarks are where the lens images them
        T_c_s = se3.inverse(update.prediction.T_s_c)
        for view, camera in enumerate(update.prediction.cameras):
            rows = marks.view == view
            p_c = se3.transform(T_c_s[view], marks.points_s[marks.index[rows]])
            off = np.linalg.norm(camera.project(p_c) - marks.uv[rows], axis=1)
            assert np.median(off) < 0.2
        # other programs read a lens too
        for eye, camera in estimated.cameras(update).items():
            assert type(camera) is type(LENSES[eye])
            assert camera.distortion[0] == pytest.approx(LENSES[eye].distortion[0], abs=2e-3)


def test_without_a_lens_the_pictures_are_as_they_are_and_a_line_says_so(calibrated, scene):
    localizer, updates, network = driven(scene, False, EXACT)
    taken = [k.frame.bgr() for k in lit(windows(N)[-1]).keyframes()]
    assert all(np.array_equal(a, b) for a, b in zip(network.given, taken, strict=True))
    lines = [line for update in updates for line in update.notices]
    assert sum("is not known yet" in line for line in lines) == 1
    bent = position_error(localizer.finish().T_w_c, scene.T_w_p).max()
    straight = position_error(calibrated[0].trajectory().T_w_c, scene.T_w_p).max()
    assert bent > 5 * straight
