"""Pose from points: exact, robust, with a correct covariance, and always a rotation."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.pnp import locate, refine

CAMERA = Perspective.from_hfov(80, 640, 240)
BARREL = Perspective(300.0, 310.0, 322.0, 118.0, 640, 240, (-0.25, 0.06, 1e-3, -1e-3))
FISHEYE = Fisheye(290.0, 290.0, 318.0, 121.0, 640, 240, (0.03, -0.01, 0.002, 0.0))
THRESHOLD_PX = 3.0


def scene(
    camera: Camera = CAMERA, n: int = 120, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """World points (n, 3) in front of a camera, its pose (4, 4) and their exact pixels (n, 2)."""
    rng = np.random.default_rng(seed)
    T_w_c = se3.exp(np.array([3.0, -1.0, 2.0, 0.1, 0.4, -0.05]))
    uv = rng.uniform([0, 0], [639, 239], (n, 2))
    p_c = camera.back_project(uv, rng.uniform(4, 40, n))
    return se3.transform(T_w_c, p_c), T_w_c, uv


@pytest.mark.parametrize("camera", [CAMERA, BARREL, FISHEYE])
def test_exact_pixels_give_the_exact_pose(camera: Camera) -> None:
    p_w, T_w_c, uv = scene(camera)
    start = T_w_c @ se3.exp(np.array([0.3, 0.1, -0.4, 0.01, -0.02, 0.01]))
    fit = refine(camera, p_w, uv.astype(np.float32), start, THRESHOLD_PX)
    assert fit is not None and fit.inlier.all()
    np.testing.assert_allclose(fit.T_w_c, T_w_c, atol=1e-4)


@pytest.mark.parametrize("camera", [CAMERA, BARREL, FISHEYE])
def test_the_pose_is_robust_to_outliers_and_a_bad_prediction(camera: Camera) -> None:
    p_w, T_w_c, uv = scene(camera)
    rng = np.random.default_rng(1)
    wrong = rng.permutation(len(uv))[:40]
    uv[wrong] = rng.uniform([0, 0], [639, 239], (40, 2))
    start = T_w_c @ se3.exp(np.array([2.0, 1.0, -2.0, 0.3, -0.3, 0.2]))
    fit = locate(camera, p_w, uv.astype(np.float32), start, THRESHOLD_PX)
    assert fit is not None
    np.testing.assert_allclose(fit.T_w_c, T_w_c, atol=1e-3)
    assert fit.inlier.sum() >= 80 and fit.inlier[wrong].sum() < 4


def test_the_covariance_matches_the_errors_from_noisy_pixels() -> None:
    p_w, T_w_c, uv = scene()
    rng = np.random.default_rng(2)
    distances = []
    for _ in range(60):
        noisy = (uv + rng.normal(0, 0.5, uv.shape)).astype(np.float32)
        fit = refine(CAMERA, p_w, noisy, T_w_c, THRESHOLD_PX)
        assert fit is not None
        miss = se3.log(se3.inverse(fit.T_w_c) @ T_w_c)
        distances.append(miss @ np.linalg.solve(fit.covariance, miss))
    # chi-square with six degrees of freedom
    assert 4.5 < np.mean(distances) < 8.0


def test_poses_predicted_from_poses_stay_rotations() -> None:
    p_w, T_w_c, uv = scene()
    seen = uv.astype(np.float32)
    T_map_odom, T_o_c = np.eye(4), T_w_c
    for _ in range(60):
        # as the tracker does for each frame: products increase the deviation from a rotation
        T_map_odom = T_w_c @ se3.inverse(T_o_c)
        for _ in range(3):
            fit = refine(CAMERA, p_w, seen, T_map_odom @ T_o_c, THRESHOLD_PX)
            assert fit is not None
            T_o_c = se3.inverse(T_map_odom) @ fit.T_w_c
    R = T_o_c[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(T_o_c, T_w_c, atol=1e-3)
