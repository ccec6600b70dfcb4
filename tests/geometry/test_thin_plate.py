import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calm_edge.geometry import se3, thin_plate

seeds = st.integers(0, 10_000)


def cloud(seed: int, n: int = 25, size: float = 10.0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (n, 3))


def bent(p: np.ndarray) -> np.ndarray:
    """A smooth non-linear deformation of a volume 20 units wide."""
    return p + np.stack(
        [np.sin(p[:, 1] / 8), 0.02 * p[:, 0] * p[:, 2], 0.5 * np.cos(p[:, 0] / 6)], -1
    )


@settings(max_examples=25, deadline=None)
@given(seeds, st.sampled_from([0.0, 1e-4, 1.0, 100.0]))
def test_an_affine_map_is_reproduced_at_any_stiffness(seed, stiffness):
    rng = np.random.default_rng(seed)
    A, t = np.eye(3) + rng.normal(0, 0.2, (3, 3)), rng.normal(0, 5, 3)
    source, points = cloud(seed), cloud(seed + 1, 50, 30.0)
    plate = thin_plate.fit(source, source @ A + t, stiffness)
    np.testing.assert_allclose(plate.apply(points), points @ A + t, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_without_stiffness_it_interpolates(seed):
    source = cloud(seed)
    target = source + np.random.default_rng(seed).normal(0, 1, source.shape)
    np.testing.assert_allclose(thin_plate.fit(source, target, 0.0).apply(source), target, atol=1e-6)


@settings(max_examples=25, deadline=None)
@given(seeds, st.floats(0.01, 100), st.floats(-3, 3))
def test_the_fit_does_not_depend_on_frame_or_unit(seed, unit, angle):
    source, points = cloud(seed), cloud(seed + 1)
    T = se3.exp(np.array([5.0, -3, 2, angle, 0.5 * angle, 0.1]))
    plate = thin_plate.fit(source, bent(source), 1e-2)
    other = thin_plate.fit(
        unit * se3.transform(T, source), unit * se3.transform(T, bent(source)), 1e-2
    )
    np.testing.assert_allclose(
        other.apply(unit * se3.transform(T, points)) / unit,
        se3.transform(T, plate.apply(points)),
        atol=1e-6,
    )


def test_a_smooth_deformation_is_interpolated_between_the_controls():
    source, points = cloud(0, 150), cloud(1, 500, 8.0)
    before = np.linalg.norm(bent(points) - points, axis=1).mean()
    plate = thin_plate.fit(source, bent(source), 1e-4)
    after = np.linalg.norm(bent(points) - plate.apply(points), axis=1).mean()
    assert after < before / 10
    # an affine map alone cannot do that
    affine = thin_plate.fit(source, bent(source), 1e6)
    assert np.linalg.norm(bent(points) - affine.apply(points), axis=1).mean() > 3 * after


def test_stiffness_trades_fidelity_for_smoothness():
    source = cloud(3)
    target = source + np.random.default_rng(0).normal(0, 1, source.shape)
    plates = [thin_plate.fit(source, target, s) for s in (0.0, 1e-2, 1.0, 100.0)]
    misses = [np.linalg.norm(p.apply(source) - target) for p in plates]
    bends = [np.linalg.norm(p.weights) for p in plates]
    assert misses == sorted(misses) and misses[-1] > 1.0
    assert bends == sorted(bends, reverse=True)


def test_the_solution_minimises_the_stated_energy():
    source = cloud(4)
    target = source + np.random.default_rng(1).normal(0, 1, source.shape)
    stiffness = 0.05
    plate = thin_plate.fit(source, target, stiffness)
    y = (target - plate.centre) / plate.size
    x = plate.controls
    P = np.hstack([x, np.ones((len(x), 1))])
    U = np.linalg.norm(x[:, None] - x, axis=-1)

    def energy(weights, affine):
        return ((U @ weights + P @ affine - y) ** 2).sum() - stiffness * np.trace(
            weights.T @ U @ weights
        )

    best = energy(plate.weights, plate.affine)
    null = np.linalg.svd(P.T)[2][4:].T  # weights that the affine part cannot explain
    rng = np.random.default_rng(2)
    for _ in range(50):
        dw = null @ rng.normal(0, 0.01, (null.shape[1], 3))
        assert energy(plate.weights + dw, plate.affine + rng.normal(0, 0.01, (4, 3))) > best


def test_the_result_does_not_depend_on_the_tile_size(monkeypatch):
    source, points = cloud(0, 40), cloud(1, 1000)
    plate = thin_plate.fit(source, bent(source), 1e-4)
    whole = plate.apply(points)
    monkeypatch.setattr(thin_plate, "TILE", 7)
    np.testing.assert_allclose(plate.apply(points), whole, atol=1e-12)
    assert plate.apply(np.empty((0, 3))).shape == (0, 3)


def test_determinants_are_the_numeric_volume_ratio():
    source = cloud(0, 40)
    plate = thin_plate.fit(source, bent(source), 1e-4)
    points, h = cloud(1, 20), 1e-5
    J = np.stack(
        [(plate.apply(points + h * e) - plate.apply(points - h * e)) / (2 * h) for e in np.eye(3)],
        -1,
    )
    np.testing.assert_allclose(plate.determinants(points), np.linalg.det(J), atol=1e-6)


def test_worst_at_controls_bounds_every_direction_of_approach():
    source = cloud(0, 12)
    target = source + np.random.default_rng(5).normal(0, 2, source.shape)
    plate = thin_plate.fit(source, target, 1e-4)
    worst = plate.worst_at_controls()
    rng = np.random.default_rng(6)
    around = rng.normal(size=(4000, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    for i, control in enumerate(source):
        near = plate.determinants(control + 1e-6 * around)
        assert near.min() >= worst[i] - 1e-4
        assert near.min() <= worst[i] + 0.2 * abs(near.max() - near.min()) + 1e-3


def rotated(p: np.ndarray) -> np.ndarray:
    return se3.transform(se3.exp(np.array([1.0, 2, 3, 0.1, -0.2, 0.3])), p)


FLAT = np.random.default_rng(0).uniform(-5, 5, (30, 3)) * [1, 1, 0] + [0, 0, 4]
LINE = np.linspace(0, 1, 9)[:, None] * [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("source", "kind"),
    [
        (np.empty((0, 3)), "identity"),
        (np.ones((1, 3)), "translation"),
        (np.ones((7, 3)), "translation"),
        (LINE, "translation"),
        (cloud(0, 3), "rigid"),
        (FLAT, "rigid"),
        (cloud(0, 4), "thin_plate"),
    ],
)
def test_degenerate_controls_fall_back_by_the_stated_rule(source, kind):
    plate = thin_plate.fit(source, rotated(source), 1e-4)
    assert len(plate.controls) == (len(source) if kind == "thin_plate" else 0)
    points = cloud(9, 50, 100.0)
    assert np.isfinite(plate.apply(points)).all()
    if kind == "rigid":
        np.testing.assert_allclose(plate.apply(points), rotated(points), atol=1e-8)
    if kind == "translation":
        shift = rotated(source).mean(0) - source.mean(0)
        np.testing.assert_allclose(plate.apply(points), points + shift, atol=1e-9)
    if kind == "identity":
        np.testing.assert_array_equal(plate.apply(points), points)


def test_a_mirrored_flat_patch_is_turned_not_mirrored():
    plate = thin_plate.fit(FLAT, FLAT * [1, 1, -1], 1e-4)
    assert plate.determinants(cloud(0))[0] == pytest.approx(1.0)


def test_repeated_controls_with_conflicting_targets_stay_finite():
    source = np.repeat(cloud(0, 10), 2, axis=0)
    target = source + np.tile([[0.5, 0, 0], [-0.5, 0, 0]], (10, 1))
    plate = thin_plate.fit(source, target, 1e-4)
    np.testing.assert_allclose(plate.apply(source), source, atol=1e-3)


def test_rows_that_are_not_finite_are_ignored():
    source, target = cloud(0), bent(cloud(0))
    expected = thin_plate.fit(source[2:], target[2:], 1e-4).apply(cloud(1))
    source[0, 1], target[1, 2] = np.nan, np.inf
    np.testing.assert_array_equal(thin_plate.fit(source, target, 1e-4).apply(cloud(1)), expected)


def test_wrong_arguments_are_errors():
    with pytest.raises(ValueError, match=r"expected two \(N, 3\)"):
        thin_plate.fit(np.zeros((3, 3)), np.zeros((4, 3)), 1e-4)
    with pytest.raises(ValueError, match="stiffness"):
        thin_plate.fit(cloud(0), cloud(0), float("nan"))
