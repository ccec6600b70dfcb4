import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph import assistant_factor

RNG = np.random.default_rng(5)


def random_poses(n, size):
    return se3.exp(RNG.normal(size=(n, 6)) * size)


def test_consistent_measurements_leave_no_residual():
    X_i, X_j, rig = random_poses(4, 0.8), random_poses(4, 0.8), random_poses(1, 0.5)[0]
    measured = se3.inverse(X_j @ rig) @ X_i @ rig
    assert np.abs(assistant_factor.residual(measured, X_i @ rig, X_j @ rig)).max() < 1e-12


def test_derivatives_match_differences_even_far_from_agreement():
    n, h = 6, 1e-6
    X_i, X_j, rig = random_poses(n, 0.6), random_poses(n, 0.6), random_poses(1, 0.5)[0]
    Z = random_poses(n, 0.6)
    at = assistant_factor.residual(Z, X_i @ rig, X_j @ rig)
    linear = assistant_factor.coupled(at, X_i, X_j, rig)

    def r(Z, X_i, X_j, rig):
        return assistant_factor.residual(Z, X_i @ rig, X_j @ rig)

    for k, axis in enumerate(np.eye(6)):
        plus, minus = se3.exp(axis * h), se3.exp(-axis * h)

        def slope(f, plus=plus, minus=minus):
            return (f(plus) - f(minus)) / (2 * h)

        assert np.allclose(linear.by_i[..., k], slope(lambda d: r(Z, X_i @ d, X_j, rig)), atol=1e-7)
        assert np.allclose(linear.by_j[..., k], slope(lambda d: r(Z, X_i, X_j @ d, rig)), atol=1e-7)
        by_rig = slope(lambda d: r(Z, X_i, X_j, rig @ d))
        assert np.allclose(linear.by_rig[..., k], by_rig, atol=1e-7)
