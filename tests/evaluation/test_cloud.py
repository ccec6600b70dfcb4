"""Point cloud errors of maps with known displacement."""

import numpy as np
import pytest

from calm_edge.evaluation import cloud

PATH = np.arange(0, 60, 1.0)[:, None] * [0, 0, 1.0]


def _plane(y: float = 1.5, half: float = 6.0) -> np.ndarray:
    x, z = np.meshgrid(np.arange(-half, half, 0.05), np.arange(0, 20, 0.05))
    return np.stack([x.ravel(), np.full(x.size, y), z.ravel()], 1)


def test_a_plane_at_a_known_distance() -> None:
    error = cloud.compare(_plane(1.5 + 0.4), _plane(), PATH)
    assert error is not None
    assert error.accuracy_m == pytest.approx(0.4, rel=0.01)
    assert error.chamfer_m == pytest.approx((error.accuracy_m + error.completeness_m) / 2)


def test_a_missing_half_costs_completeness_only() -> None:
    whole = _plane()
    error = cloud.compare(whole[whole[:, 0] < 0], whole, PATH)
    assert error is not None
    assert error.accuracy_m < 0.02
    # the missing half is 0..6 m away, truncated at 5: (12.5 + 5) / 6 over half the points
    assert error.completeness_m == pytest.approx(0.5 * (12.5 + 5) / 6, rel=0.03)


def test_far_points_are_cropped_and_far_errors_truncated() -> None:
    far = _plane() + np.array([60.0, 0, 0])
    ours = np.concatenate([_plane(), far, [[np.nan, 0, 0]]])
    error = cloud.compare(ours, _plane(), PATH)
    assert error is not None and error.accuracy_m < 0.01
    error = cloud.compare(_plane() + np.array([0, 20.0, 0]), _plane(), PATH)
    assert error is not None and error.chamfer_m == pytest.approx(5.0)
    assert cloud.compare(far, _plane(), PATH) is None


def test_point_density_has_no_influence() -> None:
    truth = _plane()
    crowd = np.tile(truth[:1] + np.array([0, 1.0, 0]), (100_000, 1))
    lone = cloud.compare(np.concatenate([truth, crowd[:1]]), truth, PATH)
    many = cloud.compare(np.concatenate([truth, crowd]), truth, PATH)
    assert lone is not None and many is not None
    assert many.accuracy_m == pytest.approx(lone.accuracy_m, abs=1e-4)


def test_voxel_means() -> None:
    points = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [-0.0, 0.4, 0]])
    means = cloud.voxel_means(points)
    assert sorted(means.round(6).tolist()) == [[0, 0.4, 0], [0.05, 0, 0], [0.2, 0, 0]]
