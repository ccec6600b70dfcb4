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


def test_ghosts_are_what_hangs_above_the_road() -> None:
    """A camera 1.3 m above a road, between two walls; a car of a map that has gone."""
    T_w_c = np.tile(np.eye(4), (20, 1, 1))
    T_w_c[:, :3, 3] = PATH[:20]
    # the road turns: the camera looks along x, its own z
    turn = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])
    T_w_c[:, :3, :3], T_w_c[:, :3, 3] = turn, PATH[:20] @ turn.T
    road = _plane(1.3) @ turn.T
    wall = np.stack([*np.meshgrid(np.arange(-3, 1.2, 0.05), np.arange(0, 20, 0.05))], -1)
    wall = wall.reshape(-1, 2)
    walls = np.concatenate([np.insert(wall, 0, x, axis=1) for x in (-5.0, 5.0)]) @ turn.T
    truth = np.concatenate([road, walls])
    assert cloud.ghosts(truth, truth, T_w_c).count == 0
    assert cloud.ghosts(truth + 0.1, truth, T_w_c).count == 0
    car = np.stack([*np.meshgrid(np.arange(-3, -1.5, 0.15), np.arange(-0.4, 0.6, 0.15))], -1)
    car = np.insert(car.reshape(-1, 2), 2, 8.0, axis=1) @ turn.T
    below = car + np.array([0, 2.0, 0])
    beside = car + 20.0 * turn[:, 0]
    nothing = np.full((3, 3), np.nan)
    found = cloud.ghosts(np.concatenate([truth, car, below, beside, nothing]), truth, T_w_c)
    assert 0.7 * len(car) < found.count <= len(car)
    assert found.share == found.count / found.points < 0.1
    assert cloud.ghosts(nothing, truth, T_w_c).share == 0
