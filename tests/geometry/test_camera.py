"""Both camera models: comparison with OpenCV, numeric derivatives, round trips, validity limits."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calm_edge.geometry.camera import Camera, Perspective, back_project_each, project_each
from calm_edge.geometry.fisheye import Fisheye

SIZE = (640, 400)
PINHOLE = Perspective(410.0, 396.0, 315.5, 204.0, *SIZE)
BARREL = Perspective(300.0, 290.0, 322.0, 197.0, *SIZE, (-0.28, 0.09, 1e-3, -2e-3, -0.012))
RATIONAL = Perspective(
    260.0, 262.0, 318.0, 201.0, *SIZE, (3.1, 1.2, -4e-4, 3e-4, 0.05, 3.4, 2.1, 0.25)
)
PILLOW = Perspective(420.0, 424.0, 310.0, 190.0, *SIZE, (0.11,))
FISHEYE = Fisheye(230.0, 228.0, 321.0, 199.0, *SIZE, (0.04, -0.012, 0.003, -0.0006))
EQUIDISTANT = Fisheye(240.0, 240.0, 319.5, 199.5, *SIZE)
CAMERAS = (PINHOLE, BARREL, RATIONAL, PILLOW, FISHEYE, EQUIDISTANT)
every_camera = pytest.mark.parametrize("camera", CAMERAS)


def points(camera: Camera, n: int = 400, below_deg: float = 85.0) -> np.ndarray:
    """Random points (n, 3) around the axis, below an angle off it and within the model's limit."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, min(0.97 * camera.max_angle, np.radians(below_deg)), n)
    around = rng.uniform(0, 2 * np.pi, n)
    ray = [np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)]
    return np.stack(ray, -1) * rng.uniform(0.5, 80, (n, 1))


def numeric(f: Callable[[np.ndarray], np.ndarray], x: np.ndarray, step: float) -> np.ndarray:
    """Central differences (..., out, in) of f at x (..., in)."""
    moves = np.eye(x.shape[-1]) * step
    return np.stack([(f(x + m) - f(x - m)) / (2 * step) for m in moves], -1)


def of_opencv(camera: Camera, p_c: np.ndarray) -> np.ndarray:
    none = np.zeros(3)
    if isinstance(camera, Fisheye):
        D = np.array(camera.distortion or (0.0,) * 4)
        return cv2.fisheye.projectPoints(p_c[None], none, none, camera.matrix, D)[0][0]
    D = np.zeros(8)
    D[: len(camera.distortion)] = camera.distortion
    return cv2.projectPoints(p_c, none, none, camera.matrix, D)[0][:, 0]


@every_camera
def test_pixels_are_those_of_opencv(camera):
    p_c = points(camera)
    np.testing.assert_allclose(camera.project(p_c), of_opencv(camera, p_c), rtol=1e-9, atol=1e-6)


@every_camera
def test_inverse_is_that_of_opencv(camera):
    uv = camera.project(points(camera, below_deg=35.0))
    if isinstance(camera, Fisheye):
        D = np.array(camera.distortion or (0.0,) * 4)
        there = cv2.fisheye.undistortPoints(uv[None], camera.matrix, D)[0]
    else:
        D = np.zeros(8)
        D[: len(camera.distortion)] = camera.distortion
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)
        there = cv2.undistortPoints(uv[:, None], camera.matrix, D, None, None, None, stop)[:, 0]
    np.testing.assert_allclose(camera.normalized(uv), there, atol=2e-6)


@every_camera
def test_rays_invert_projection_up_to_the_limit(camera):
    p_c = points(camera)
    ray = camera.rays(camera.project(p_c))
    np.testing.assert_allclose(ray, p_c / np.linalg.norm(p_c, axis=1)[:, None], atol=1e-8)
    np.testing.assert_allclose(camera.project(ray), camera.project(p_c), rtol=1e-8, atol=1e-6)


@every_camera
def test_back_projection_has_the_depth_and_the_pixel(camera):
    p_c = points(camera, below_deg=75.0).reshape(20, 20, 3)
    back = camera.back_project(camera.project(p_c), p_c[..., 2])
    assert (back[..., 2] == p_c[..., 2]).all()
    np.testing.assert_allclose(back, p_c, atol=1e-6)


@every_camera
def test_derivative_by_the_point(camera):
    p_c = points(camera, below_deg=80.0)
    p_c /= np.linalg.norm(p_c, axis=1)[:, None]
    J = camera.project_jacobian(p_c)
    np.testing.assert_allclose(J, numeric(camera.project, p_c, 1e-6), rtol=1e-4, atol=1e-3)


@every_camera
def test_derivative_by_the_parameters(camera):
    p_c = points(camera, below_deg=60.0)
    given = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion])

    def moved(x: np.ndarray) -> np.ndarray:
        return type(camera)(*x[:4], *SIZE, tuple(x[4:])).project(p_c)

    J = camera.parameter_jacobian(p_c)
    assert J.shape == (len(p_c), 2, 4 + len(camera.distortion))
    np.testing.assert_allclose(J, numeric(moved, given, 1e-6), rtol=1e-5, atol=1e-4)


@every_camera
def test_derivative_of_the_rays(camera):
    uv = camera.project(points(camera, below_deg=70.0))
    uv = uv[np.linalg.norm(uv - SIZE, axis=1) < 2000]
    np.testing.assert_allclose(
        camera.rays_jacobian(uv), numeric(camera.rays, uv, 1e-3), rtol=1e-4, atol=1e-7
    )


@pytest.mark.parametrize("camera", [BARREL, FISHEYE, EQUIDISTANT])
def test_on_the_axis(camera):
    p_c = np.array([[0.0, 0, 3.0], [1e-9, 0, 3.0]])
    centre = np.array([camera.cx, camera.cy])
    np.testing.assert_allclose(camera.project(p_c), [centre, centre], atol=1e-6)
    np.testing.assert_allclose(camera.rays(centre), [0, 0, 1], atol=1e-12)
    focal = np.array([[camera.fx, 0, 0], [0, camera.fy, 0]])
    np.testing.assert_allclose(camera.project_jacobian(p_c[0]), focal / 3, atol=1e-3)


@pytest.mark.parametrize("camera", [BARREL, FISHEYE])
def test_radius_grows_up_to_the_limit_and_no_further(camera):
    assert np.radians(45) < camera.max_angle <= np.pi / 2
    end = min(camera.max_angle + 0.05, np.radians(89.5))
    angle = np.linspace(0, end, 4000)
    ray = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    plain = type(camera)(1.0, 1.0, 0.0, 0.0, 1, 1, (*camera.distortion[:2], 0, 0))
    if isinstance(camera, Perspective):
        plain = Perspective(1, 1, 0, 0, 1, 1, (*camera.distortion[:2], 0, 0, camera.distortion[4]))
    grows = np.diff(plain.project(ray)[:, 0]) > 0
    assert grows[angle[1:] < plain.max_angle].all()
    if plain.max_angle < end - 0.01:
        assert not grows[angle[:-1] > plain.max_angle].any()


def test_pixels_beyond_the_limit_have_no_ray():
    folding = Perspective(300.0, 300.0, 320.0, 200.0, *SIZE, (-0.35,))
    # r + k r^3 stops growing at r^2 = 1 / 1.05
    assert np.tan(folding.max_angle) ** 2 == pytest.approx(1 / 1.05)
    r = np.tan(folding.max_angle)
    reach = 300 * (r - 0.35 * r**3)
    uv = np.array([[320 + reach - 0.01, 200], [320 + reach + 0.01, 200], [320, 199 - reach]])
    assert np.isnan(folding.rays(uv)).all(1).tolist() == [False, True, True]
    assert np.isnan(folding.normalized(uv)).all(1).tolist() == [False, True, True]
    narrow = Fisheye(200.0, 200.0, 320.0, 200.0, *SIZE, (-0.2,))
    reach = 200 * (narrow.max_angle - 0.2 * narrow.max_angle**3)
    assert narrow.max_angle == pytest.approx(np.sqrt(1 / 0.6))
    uv = np.array([[320 + reach - 0.01, 200], [320 + reach + 0.01, 200]])
    assert np.isnan(narrow.rays(uv)).all(1).tolist() == [False, True]


def test_a_lens_wider_than_the_model_is_an_error():
    f = 320 / np.radians(79.9)
    assert Fisheye(f, f, 319.5, 199.5, *SIZE).max_angle == np.pi / 2
    with pytest.raises(ValueError, match="161 degrees: at most 160"):
        Fisheye(320 / np.radians(80.5), f, 319.5, 199.5, *SIZE)
    with pytest.raises(ValueError, match="180 degrees"):
        Fisheye(150.0, 150.0, 319.5, 199.5, *SIZE)


@given(st.floats(20, 150), st.integers(64, 4000), st.integers(64, 3000))
def test_hfov_spans_the_image_edges(hfov, width, height):
    camera = Perspective.from_hfov(hfov, width, height)
    edges = np.array([[-0.5, (height - 1) / 2], [width - 0.5, (height - 1) / 2]])
    left, right = camera.rays(edges)
    angle = np.degrees(np.arctan2(right[0], right[2]) - np.arctan2(left[0], left[2]))
    assert angle == pytest.approx(hfov, abs=1e-9)
    assert left[1] == pytest.approx(0, abs=1e-12)


def test_matrix_there_and_back():
    assert Perspective.from_matrix(PINHOLE.matrix, *SIZE) == PINHOLE
    p_c = points(PINHOLE, below_deg=60.0)
    q = p_c @ PINHOLE.matrix.T
    np.testing.assert_allclose(PINHOLE.project(p_c), q[:, :2] / q[:, 2:], atol=1e-9)
    assert PINHOLE.is_pinhole and Perspective(1, 1, 0, 0, 2, 2, (0.0, 0.0)).is_pinhole
    assert not BARREL.is_pinhole and not EQUIDISTANT.is_pinhole


@every_camera
def test_undistorted_pixels_are_those_of_the_matrix(camera):
    p_c = points(camera, below_deg=60.0)
    q = p_c @ camera.matrix.T
    straight = camera.undistorted(camera.project(p_c))
    np.testing.assert_allclose(straight, q[:, :2] / q[:, 2:], rtol=1e-8, atol=1e-6)


def test_another_focal_keeps_all_but_the_focals():
    longer = BARREL.with_focal(600.0)
    assert (longer.fx, longer.fy) == (600.0, pytest.approx(580.0))
    assert longer.distortion == BARREL.distortion and longer.width == BARREL.width
    assert (longer.cx, longer.cy) == (BARREL.cx, BARREL.cy)


def test_views_of_several_cameras_at_once():
    cameras, view = (PINHOLE, FISHEYE, BARREL), np.array([2, 0, 2, 1, 1, 0])
    p_c = points(BARREL, 6, below_deg=40.0)
    uv = project_each(cameras, view, p_c)
    for row, n in enumerate(view):
        np.testing.assert_array_equal(uv[row], cameras[n].project(p_c[[row]])[0])
    np.testing.assert_allclose(back_project_each(cameras, view, uv, p_c[:, 2]), p_c, atol=1e-6)
    nothing = np.zeros(0, np.int64)
    assert project_each(cameras, nothing, np.zeros((0, 3))).shape == (0, 2)


@every_camera
def test_scaled_moves_pixel_edges_not_centres(camera):
    p_c = points(camera, below_deg=60.0)
    small = camera.scaled(0.25, 0.5)
    assert (small.width, small.height) == (160, 200)
    expected = (camera.project(p_c) + 0.5) * [0.25, 0.5] - 0.5
    np.testing.assert_allclose(small.project(p_c), expected, rtol=1e-12, atol=1e-9)


def test_scaled_matches_an_image_resized_by_opencv():
    # a linear ramp keeps its value at every place under area averaging
    ramp = np.tile(np.arange(64, dtype=np.float32), (32, 1))
    small = cv2.resize(ramp, (16, 8), interpolation=cv2.INTER_AREA)
    camera = Perspective(40, 40, 31.5, 15.5, 64, 32)
    p_c = camera.back_project(np.array([20.0, 10.0]), np.float64(1))
    u = camera.scaled(0.25, 0.25).project(p_c)[0]
    assert np.interp(u, np.arange(16), small[2]) == pytest.approx(20.0)


def test_points_in_the_camera_plane_stay_finite():
    p_c = np.array([[1.0, 1, 0], [0, 0, 0]])
    for camera in (PINHOLE, EQUIDISTANT):
        assert np.isfinite(camera.project(p_c)).all()


def test_a_camera_is_a_value():
    assert pickle.loads(pickle.dumps(BARREL)) == BARREL
    assert len({BARREL, pickle.loads(pickle.dumps(BARREL)), FISHEYE}) == 2
