import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calm_edge.geometry import pinhole

focals = st.floats(50, 2000)
pixels = st.tuples(st.floats(-100, 2000), st.floats(-100, 1500)).map(np.array)


@st.composite
def cameras(draw: st.DrawFn) -> np.ndarray:
    K = pinhole.matrix(draw(focals), draw(focals), draw(st.floats(0, 1500)), draw(focals))
    K[0, 1] = draw(st.floats(-5, 5))
    return K


@given(cameras(), pixels, st.floats(0.1, 500))
def test_projection_undoes_back_projection(K, uv, depth):
    p = pinhole.back_project(K, uv, np.float64(depth))
    assert p[2] == depth
    np.testing.assert_allclose(pinhole.project(K, p), uv, atol=1e-6)


@given(cameras(), pixels, st.floats(0.1, 500))
def test_projection_is_the_matrix_product(K, uv, depth):
    p = np.array([uv[0] / 100, uv[1] / 100, depth])
    q = K @ p
    np.testing.assert_allclose(pinhole.project(K, p), q[:2] / q[2], atol=1e-6)


@given(st.floats(20, 150), st.integers(64, 4000), st.integers(64, 3000))
def test_hfov_spans_the_image_edges(hfov, width, height):
    K = pinhole.from_hfov(hfov, width, height)
    left = pinhole.back_project(K, np.array([-0.5, (height - 1) / 2]), np.float64(1))
    right = pinhole.back_project(K, np.array([width - 0.5, (height - 1) / 2]), np.float64(1))
    angle = np.degrees(np.arctan2(right[0], 1) - np.arctan2(left[0], 1))
    assert angle == pytest.approx(hfov, abs=1e-9)
    assert left[1] == pytest.approx(0, abs=1e-12)


@given(cameras(), st.floats(0.1, 4), st.floats(0.1, 4), pixels)
def test_resized_moves_pixel_edges_not_centres(K, sx, sy, uv):
    p = pinhole.back_project(K, uv, np.float64(3.0))
    small = pinhole.project(pinhole.resized(K, sx, sy), p)
    np.testing.assert_allclose(small, (uv + 0.5) * [sx, sy] - 0.5, atol=1e-6)


def test_resized_is_what_opencv_does_to_an_image():
    # a linear ramp keeps its value at every place under area averaging
    ramp = np.tile(np.arange(64, dtype=np.float32), (32, 1))
    small = cv2.resize(ramp, (16, 8), interpolation=cv2.INTER_AREA)
    K = pinhole.matrix(40, 40, 31.5, 15.5)
    p = pinhole.back_project(K, np.array([20.0, 10.0]), np.float64(1))
    u = pinhole.project(pinhole.resized(K, 0.25, 0.25), p)[0]
    assert np.interp(u, np.arange(16), small[2]) == pytest.approx(20.0)


def test_stacks_of_cameras_and_points():
    K = np.array([pinhole.from_hfov(h, 640, 480) for h in (50, 70, 90)])
    p = np.random.default_rng(0).uniform(1, 5, (4, 3, 3))
    uv = pinhole.project(K, p)
    for i in range(4):
        for j in range(3):
            np.testing.assert_allclose(uv[i, j], pinhole.project(K[j], p[i, j]))


def test_points_in_the_camera_plane_stay_finite():
    uv = pinhole.project(pinhole.matrix(100, 100, 50, 50), np.array([[1.0, 1, 0], [0, 0, 0]]))
    assert np.isfinite(uv).all()
