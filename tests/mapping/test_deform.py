import numpy as np
import pytest

from calm_edge.geometry import se3, thin_plate
from calm_edge.mapping.deform import cells, control_points, fit_deformation, torn


def room(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-8, -2, 2], [8, 2, 30], (n, 3))


def bent(p: np.ndarray) -> np.ndarray:
    return p * (1 + 0.04 * np.sin(p[:, 2:] / 6))


def fitted(p, target, probes=None, n=None, stiffness=1e-4, most=150):
    n = np.full(len(p), 2) if n is None else n
    probes = p if probes is None else probes
    return fit_deformation(p, target, n, np.zeros(3), probes, stiffness, most)


def test_a_smooth_distortion_is_removed_between_the_control_points():
    p, points = room(0, 2000), room(1, 500)
    deformation = fitted(p, bent(p))
    before = np.linalg.norm(points - bent(points), axis=1).mean()
    after = np.linalg.norm(deformation.apply(points) - bent(points), axis=1).mean()
    assert after < before / 5
    assert len(deformation.plate.controls) <= 150


def test_no_point_moves_farther_than_the_control_points_do():
    p = room(0, 300)
    deformation = fitted(p, bent(p))
    far = np.random.default_rng(1).uniform(-500, 500, (1000, 3))
    moved = np.linalg.norm(deformation.apply(far) - far, axis=1)
    unguarded = np.linalg.norm(deformation.plate.apply(far) - far, axis=1)
    assert unguarded.max() > deformation.limit
    assert moved.max() <= deformation.limit * (1 + 1e-9)
    assert deformation.limit <= np.linalg.norm(bent(p) - p, axis=1).max() + 1e-9


def test_a_folding_map_is_stiffened_until_it_no_longer_folds():
    rng = np.random.default_rng(2)
    p = room(2, 120)
    target = p + rng.normal(0, 1.5, p.shape)
    probes = room(3, 2000)
    likely = np.linalg.norm(target - p, axis=1) < 0.25 * np.linalg.norm(p, axis=1)
    p, target = p[likely], target[likely]
    alone = np.ones(len(p), int)
    deformation = fitted(p, target, probes, alone)
    assert thin_plate.fit(p, target, 1e-4).determinants(probes).min() < 0.1
    assert deformation.plate.determinants(probes).min() >= 0.1
    assert deformation.plate.worst_at_controls().min() >= 0.1


def test_a_map_that_folds_at_any_stiffness_is_moved_rigidly():
    # all targets in a slab: even the affine fit has almost no volume
    p = room(0, 200) + np.array([0, 0, 60])
    target = p * [1.0, 1.0, 0.0] + [0, 0, 75]
    deformation = fitted(p, target)
    np.testing.assert_allclose(deformation.plate.determinants(p), 1)


def test_wrong_associations_are_no_control_points():
    p = room(0, 400)
    target = bent(p)
    target[::40] += [12.0, 0, 0]
    points = room(1, 200)
    deformation = fitted(p, target, most=400)
    assert deformation.limit < 2.0
    assert np.linalg.norm(deformation.apply(points) - bent(points), axis=1).mean() < 0.2


def test_an_anchor_with_a_shift_unlike_its_neighbours_is_torn_if_shared():
    p, n = room(0, 500), np.full(500, 2)
    shift = bent(p) - p
    shift[7] += [0.0, 1.0, 0.0]
    shift[9] += [0.0, 1.0, 0.0]
    n[9] = 1
    found = torn(p, shift, n, np.zeros(3))
    assert found[7] and not found[9]
    assert found.mean() < 0.15
    assert not torn(p, np.zeros_like(p), n, np.zeros(3)).any()
    assert not torn(p[:5], shift[:5], n[:5], np.zeros(3)).any()


def test_cells_are_the_finest_lattice_that_is_allowed():
    p = np.vstack([np.random.default_rng(0).normal([0, 0, 5], 0.3, (5000, 3)), room(1, 500)])
    label = cells(p, 150)
    assert 75 <= label.max() + 1 <= 150
    assert set(label) == set(range(label.max() + 1))
    # evenly over space: the dense cluster of 5,000 points gets few cells
    assert len(set(label[5000:]) - set(label[:5000])) > 0.8 * (label.max() + 1)
    # points of a cell are close together
    spread = [np.ptp(p[label == c], axis=0).max() for c in range(label.max() + 1)]
    assert max(spread) < 32 / 4
    np.testing.assert_array_equal(cells(p[:100], 150), np.arange(100))
    assert set(cells(np.zeros((300, 3)), 150)) == {0}


def test_a_control_point_is_the_mean_of_the_most_observed_anchors_of_its_cell():
    p = np.array([[0.0, 0, 0], [0.2, 0, 0], [0.1, 0, 0], [50, 0, 0], [50, 0, 0.2]])
    target = p + np.array([[1.0, 0, 0], [2, 0, 0], [9, 9, 9], [0, 1, 0], [0, 3, 0]])
    source, moved = control_points(p, target, np.array([3, 3, 2, 1, 1]), 2)
    order = np.argsort(source[:, 0])
    np.testing.assert_allclose(source[order], [[0.1, 0, 0], [50, 0, 0.1]])
    np.testing.assert_allclose(moved[order], [[1.6, 0, 0], [50, 2, 0.1]])
    alone = control_points(p, target, np.array([3, 3, 2, 1, 1]), 5)
    np.testing.assert_array_equal(alone[0], p)


def test_the_noise_of_single_anchors_does_not_dent_the_map():
    p, points = room(0, 3000), room(1, 500)
    noise = np.random.default_rng(2).normal(0, 0.3, p.shape)
    deformation = fitted(p, bent(p) + noise, points)
    off = np.linalg.norm(deformation.apply(points) - bent(points), axis=1)
    assert off.mean() < 0.5 * np.linalg.norm(noise, axis=1).mean()


@pytest.mark.parametrize("size", [0, 1, 2, 3])
def test_with_very_few_anchors_the_map_stays_finite_and_rigid(size):
    p = room(0, size)
    points = room(1, 100)
    T = se3.exp(np.array([0.1, 0, 0.2, 0, 0.01, 0]))
    moved = fitted(p, se3.transform(T, p), points).apply(points)
    assert np.isfinite(moved).all()
    if size == 0:
        np.testing.assert_array_equal(moved, points)
