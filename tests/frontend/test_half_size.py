"""A sub-map scaled to half the image size is equivalent."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from calm_edge.config import FrontendConfig
from calm_edge.frontend.half_size import halved
from calm_edge.frontend.landmark_cloud import of_update
from calm_edge.frontend.tracker import Tracker
from calm_edge.geometry import se3
from calm_edge.types import Bytes, PoseStatus
from device.frame import Eye, Frame
from tests.frontend.plane_world import PlaneWorld, drive

WORLD = PlaneWorld()
IDS, STAMPS = (0, 1, 2), (10**9, 10**9 + 3 * 10**8, 10**9 + 6 * 10**8)


def half_picture(gray: Bytes) -> Bytes:
    """Decoded as in the tracker process."""
    jpeg = cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    return Frame(Eye.PRIMARY, 0, 1, jpeg).gray(2)


@pytest.mark.parametrize("with_depth", [False, True])
def test_its_points_stay_in_place(with_depth: bool) -> None:
    poses = drive(7)
    update = WORLD.update(0, IDS, STAMPS, poses[[0, 3, 6]], with_depth=with_depth)
    gray = half_picture(WORLD.render(poses[6]))
    small = of_update(halved(update), 200, gray)
    assert len(small.p_w) > 50
    # all lie on the wall
    np.testing.assert_allclose(small.p_w[:, 2], 10.0, atol=0.02)
    if not with_depth:
        np.testing.assert_allclose(small.p_w, of_update(update, 200).p_w, atol=1e-4)


def test_sigmas_are_scaled() -> None:
    update = WORLD.update(0, IDS, STAMPS, drive(7)[[0, 3, 6]], with_depth=False)
    marks = update.prediction.landmarks
    assert marks is not None
    sigma = np.full(len(marks.uv), 0.5, np.float32)
    prediction = replace(update.prediction, landmarks=replace(marks, sigma_px=sigma))
    small = halved(replace(update, prediction=prediction)).prediction.landmarks
    assert small is not None and small.sigma_px is not None
    assert (small.sigma_px == 0.25).all()


def test_tracking_at_half_the_size_keeps_the_pose_accurate() -> None:
    poses = drive(20)
    tracker = Tracker(FrontendConfig())
    update = halved(WORLD.update(0, IDS, STAMPS, poses[[0, 3, 6]]))
    samples = []
    for i, T in enumerate(poses):
        samples.append(tracker.track(10**9 + i * 10**8, half_picture(WORLD.render(T))))
        tracker.prepare(i // 3 if i % 3 == 0 else None)
        if i == 9:
            assert tracker.attach(update)
    live = samples[10:]
    assert all(s.status is PoseStatus.LIVE for s in live)
    apart = se3.inverse(np.stack([s.T_w_c for s in live])) @ poses[10:]
    assert np.abs(apart[:, :3, 3]).max() < 0.03


@pytest.mark.parametrize("reduction", [2, 8])
def test_raw_images_are_reduced_as_jpeg_ones(reduction: int) -> None:
    image = cv2.merge([cv2.GaussianBlur(WORLD.render(drive(1)[0]), (0, 0), 8)] * 3)
    jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 98])[1].tobytes()
    raw = Frame(Eye.PRIMARY, 0, 1, image).gray(reduction).astype(float)
    decoded = Frame(Eye.PRIMARY, 0, 1, jpeg).gray(reduction).astype(float)
    assert raw.shape == decoded.shape
    assert np.abs(raw - decoded).mean() < 2
