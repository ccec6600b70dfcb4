"""Cameras of the pictures of a scripted backbone, and what it takes them for."""

from dataclasses import replace

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors
from bench.scripted.pictures import given, taken_for
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.undistortion import undistortion
from tests.bench.scripted.street_drive import batch, street

LENS = Perspective(330.0, 330.0, 319.5, 99.5, 640, 200, (-0.25, 0.06))
WRONG = replace(LENS, distortion=(-0.24, 0.06))
POINTS = np.random.default_rng(0).uniform([-4, -1, 6], [4, 1, 9], (50, 3))


def test_pictures_are_as_taken_or_undistorted_by_what_is_known():
    assert given(LENS, None) is LENS
    assert given(LENS, LENS) == undistortion(LENS).camera
    camera = given(LENS, WRONG)
    rays = WRONG.rays(LENS.project(POINTS))
    np.testing.assert_allclose(camera.project(POINTS), undistortion(WRONG).camera.project(rays))
    back = camera.back_project(camera.project(POINTS), POINTS[:, 2])
    np.testing.assert_allclose(back, POINTS, atol=1e-6)
    off = np.abs(camera.project(POINTS) - undistortion(WRONG).camera.project(POINTS)).max()
    assert 0.1 < off < 5


def test_a_network_takes_every_picture_for_a_pinhole_cameras():
    plain = Perspective.from_hfov(80, 640, 200)
    assert taken_for(plain) == plain
    found = taken_for(LENS)
    assert found.is_pinhole and 0.7 * LENS.fx < found.fx < LENS.fx
    uv = LENS.pixel_grid(25, 15)
    q = LENS.normalized(uv)
    off = [((f * found.fx * q - uv + [found.cx, found.cy]) ** 2).sum() for f in (0.98, 1, 1.02)]
    assert off[1] == min(off)


@pytest.mark.parametrize("lenses", [(None, None), (LENS, LENS)])
def test_predictions_have_pinholes_and_the_pixels_of_the_pictures(lenses):
    scene = replace(street(), cameras=(LENS, LENS))
    hints = replace(batch(), lenses=lenses)
    p = ScriptedBackbone(scene, ScriptedErrors(coupled=True)).infer([], hints)
    assert all(type(camera) is Perspective for camera in p.cameras)
    marks = p.landmarks
    T_c_s = np.linalg.inv(p.T_s_c)
    p_c = (
        T_c_s[marks.view] @ np.c_[marks.points_s[marks.index], np.ones(len(marks.view))][..., None]
    )
    off = np.linalg.norm(p.cameras[0].project(p_c[:, :3, 0]) - marks.uv, axis=1)
    # undistorted pictures fit pinhole cameras, those of a lens do not
    assert (np.median(off) < 0.01) == (lenses[0] is not None)
