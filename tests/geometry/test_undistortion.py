"""Undistortion maps: identity without distortion, and the share that is cut."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.undistortion import undistortion

SIZE = (320, 200)


def test_a_pinhole_camera_keeps_its_image():
    camera = Perspective(200.0, 190.0, 150.0, 104.0, *SIZE, (0.0, 0.0))
    out = undistortion(camera)
    np.testing.assert_allclose(out.camera.matrix, camera.matrix, rtol=1e-12)
    x, y = np.meshgrid(np.arange(320), np.arange(200))
    np.testing.assert_allclose(out.map_x, x, atol=1e-4)
    np.testing.assert_allclose(out.map_y, y, atol=1e-4)
    assert out.cut == 0


@pytest.mark.parametrize(
    ("lens", "hfov_deg"),
    [
        (Perspective(190.0, 190.0, 159.5, 99.5, *SIZE, (-0.2, 0.04)), None),
        (Fisheye(120.0, 120.0, 159.5, 99.5, *SIZE, (0.02, -0.003, 0.0, 0.0)), 100.0),
    ],
)
def test_the_undistorted_image_is_that_of_the_pinhole_camera(lens, hfov_deg):
    out = undistortion(lens)
    # image with the direction of each pixel as value: smooth, so that remap interpolates it well
    x, y = np.meshgrid(np.arange(320.0), np.arange(200.0))
    directions = lens.normalized(np.stack([x, y], -1)).astype(np.float32)
    brought = cv2.remap(directions, out.map_x, out.map_y, cv2.INTER_CUBIC)
    want = out.camera.normalized(np.stack([x, y], -1))
    inside = (out.map_x > 2) & (out.map_x < 317) & (out.map_y > 2) & (out.map_y < 197)
    assert inside.mean() > 0.5
    np.testing.assert_allclose(brought[inside], want[inside], atol=5e-3)
    across = 2 * np.degrees(np.arctan(160 / out.camera.fx))
    edge = lens.rays(np.array([319.5, 99.5]))
    own = 2 * np.degrees(np.arctan2(edge[0], edge[2]))
    assert across == pytest.approx(hfov_deg or own, abs=1e-6)


def test_the_cut_is_the_share_of_pixels_outside():
    lens = Fisheye(120.0, 120.0, 159.5, 99.5, *SIZE)
    out, wide = undistortion(lens, 100.0), undistortion(lens, 140.0)
    x, y = np.meshgrid(np.arange(320), np.arange(200))
    angle = np.hypot(x - 159.5, y - 99.5) / 120
    tangent = np.tan(angle)[..., None] * np.stack([x - 159.5, y - 99.5], -1)
    tangent /= np.hypot(x - 159.5, y - 99.5)[..., None]
    reach = np.tan(np.radians(50)) * np.array([1, 200 / 320])
    assert out.cut == pytest.approx(1 - (np.abs(tangent) < reach).all(-1).mean(), abs=0.01)
    assert 0 < wide.cut < out.cut < 1


def test_pixels_outside_the_field_of_view_are_marked():
    lens = Perspective(150.0, 150.0, 159.5, 99.5, *SIZE, (-0.25,))
    out = undistortion(lens, 98.0)
    rays = out.camera.rays(np.stack(np.meshgrid(np.arange(320.0), np.arange(200.0)), -1))
    unseen = rays[..., 2] < np.cos(lens.max_angle)
    assert 0 < unseen.sum() < unseen.size
    assert (out.map_x[unseen] == -1).all() and (out.map_x[~unseen] != -1).all()
