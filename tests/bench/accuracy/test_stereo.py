"""Calibrated stereo finds the metre of a synthetic pair."""

import numpy as np
import pytest

from bench.accuracy import stereo
from calm_edge.geometry import se3

K = np.array([[600.0, 0, 320], [0, 600, 120], [0, 0, 1]])
SPACING_M = 0.5


def _scene(rng):
    return np.stack([rng.uniform(-8, 8, 300), rng.uniform(-2, 2, 300), rng.uniform(6, 25, 300)], 1)


def _pixels(points, T_c_w=None):
    p = points if T_c_w is None else se3.transform(T_c_w, points)
    return (p @ K.T)[:, :2] / p[:, 2:]


def test_disparity_gives_the_points_in_metres():
    points = _scene(np.random.default_rng(0))
    disparity = K[0, 0] * SPACING_M / points[:, 2]
    found = stereo.triangulated(_pixels(points), disparity, K, SPACING_M)
    np.testing.assert_allclose(found, points)


def test_a_motion_is_found_in_metres_among_wrong_matches():
    rng = np.random.default_rng(1)
    points = _scene(rng)
    T_w_c = se3.exp(np.array([0.1, -0.02, 2.0, 0.01, 0.05, 0.0]))
    uv = _pixels(points, se3.inverse(T_w_c)) + rng.normal(0, 0.3, (300, 2))
    uv[:60] = rng.uniform(0, 600, (60, 2))
    np.testing.assert_allclose(stereo.motion(points, uv, K), T_w_c[:3, 3], atol=0.03)


def test_too_few_points_give_no_motion():
    points = _scene(np.random.default_rng(2))[:20]
    assert stereo.motion(points, _pixels(points), K) is None


def test_the_scale_is_a_median_with_its_standard_error():
    rng = np.random.default_rng(3)
    metres = rng.uniform(2, 8, 400)
    errors = []
    for _ in range(200):
        lengths = 1.05 * metres * np.exp(rng.normal(0, 0.02, 400))
        lengths[:20] *= 3
        middle, sigma = stereo.log_scale(lengths, metres)
        assert middle == pytest.approx(np.log(1.05), abs=0.01)
        errors.append((middle - np.log(1.05)) / sigma)
    assert 0.8 < np.std(errors) < 1.2
