"""Pinhole cameras of undistorted pictures, in the pixels of the pictures as taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.through_lens import ThroughLens, lens_moved_px, lens_of
from calm_edge.geometry.undistortion import undistortion

SIZE = (640, 400)
BARREL = Perspective(300.0, 290.0, 322.0, 197.0, *SIZE, (-0.25, 0.06, 1e-3, -2e-3))
FISHEYE = Fisheye(330.0, 330.0, 321.0, 199.0, *SIZE, (0.04, -0.012))
LENSES = pytest.mark.parametrize("lens", [BARREL, FISHEYE])


def seen_by(lens, zoom=1.1, off=(3.0, -2.0)):
    """A model's camera: its focal length off by a factor, its centre by pixels."""
    cx, cy = lens.cx + off[0], lens.cy + off[1]
    return ThroughLens(zoom * lens.fx, zoom * lens.fy, cx, cy, *SIZE, lens=lens)


def points():
    rng = np.random.default_rng(0)
    return rng.uniform([-6, -3, 6], [6, 3, 12], (200, 3))


@LENSES
def test_a_right_model_has_the_camera_of_the_lens(lens):
    camera = seen_by(lens, 1.0, (0.0, 0.0))
    np.testing.assert_allclose(camera.project(points()), lens.project(points()), atol=1e-9)
    assert camera.max_angle == pytest.approx(min(lens.max_angle, np.radians(89.99)))


@LENSES
def test_a_pixel_is_undistorted_then_seen_by_the_model(lens):
    camera, maps = seen_by(lens), undistortion(lens)
    K = maps.camera.matrix @ np.linalg.inv(lens.matrix) @ camera.matrix
    in_undistorted = Perspective.from_matrix(K, *SIZE).project(points())
    as_taken = lens.project(maps.camera.rays(in_undistorted))
    np.testing.assert_allclose(camera.project(points()), as_taken, atol=1e-8)


@LENSES
def test_rays_invert_the_projection(lens):
    camera, p = seen_by(lens), points()
    ray = camera.rays(camera.project(p))
    np.testing.assert_allclose(ray, p / np.linalg.norm(p, axis=1)[:, None], atol=1e-9)
    uv = camera.project(p)
    np.testing.assert_allclose(camera.back_project(uv, p[:, 2]), p, atol=1e-7)


@LENSES
def test_undistorted_pixels_do_not_depend_on_the_model(lens):
    uv = lens.project(points())
    for camera in (seen_by(lens), seen_by(lens, 0.9)):
        np.testing.assert_allclose(camera.undistorted(uv), lens.undistorted(uv), atol=1e-9)


@LENSES
def test_derivatives_are_the_numeric_ones(lens):
    camera, p = seen_by(lens), points()
    steps = np.eye(3) * 1e-6
    numeric = np.stack([(camera.project(p + s) - camera.project(p - s)) / 2e-6 for s in steps], -1)
    np.testing.assert_allclose(camera.project_jacobian(p), numeric, rtol=1e-5, atol=1e-4)
    names, rows = ("fx", "fy", "cx", "cy"), []
    for name in names:
        value = getattr(camera, name)
        up, down = (replace(camera, **{name: value + d}) for d in (1e-4, -1e-4))
        rows.append((up.project(p) - down.project(p)) / 2e-4)
    np.testing.assert_allclose(camera.parameter_jacobian(p), np.stack(rows, -1), atol=1e-5)


@LENSES
def test_a_resized_picture_has_the_resized_camera(lens):
    camera, half = seen_by(lens), seen_by(lens).scaled(0.5, 0.5)
    np.testing.assert_allclose(
        half.project(points()), (camera.project(points()) + 0.5) / 2 - 0.5, atol=1e-8
    )
    assert (half.width, half.height) == (320, 200)


@LENSES
def test_other_programs_get_a_lens_of_their_models(lens):
    camera = seen_by(lens, off=(0.0, 0.0))
    standard = camera.standard
    assert type(standard) is type(lens) and standard.fx == pytest.approx(camera.fx)
    rays = camera.rays(camera.pixel_grid(9, 7))
    rays = rays[rays[:, 2] > 0.3]
    np.testing.assert_allclose(standard.project(rays), camera.project(rays), atol=0.02)
    # a centre off that of the lens has no exact lens
    assert np.abs(seen_by(lens).standard.project(rays) - seen_by(lens).project(rays)).max() < 3


def test_a_standard_camera_is_its_own():
    assert BARREL.standard is BARREL


def test_the_movement_of_a_lens_is_the_largest_over_the_picture():
    assert lens_of(BARREL) is None and lens_of(seen_by(BARREL)) is BARREL
    assert lens_moved_px(None, None) == 0 and lens_moved_px(BARREL, BARREL) == 0
    assert lens_moved_px(None, BARREL) == lens_moved_px(BARREL, None) == np.inf
    assert lens_moved_px(BARREL, BARREL.scaled(0.5, 0.5)) == np.inf
    moved = replace(BARREL, cx=BARREL.cx + 0.7)
    assert lens_moved_px(BARREL, moved) == pytest.approx(0.7, abs=1e-6)
    bent = replace(BARREL, distortion=(-0.26, 0.06, 1e-3, -2e-3))
    corner = BARREL.rays(np.array([639.0, 399.0]))
    there = np.linalg.norm(bent.project(corner) - [639, 399])
    assert lens_moved_px(BARREL, bent) >= there > 1
