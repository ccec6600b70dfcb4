import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.triangulation import triangulate

T_C_S = se3.exp(np.random.default_rng(1).normal(size=(4, 6)) * [1, 1, 0.5, 0.05, 0.05, 0.05])


def scene(n=40, seed=0):
    """Points (n, 4), unit homogeneous, one in four at infinity, and every view's rays (4, n, 2)."""
    rng = np.random.default_rng(seed)
    X = np.c_[rng.uniform([-8, -4, 10], [8, 4, 40], (n, 3)), np.ones(n)]
    X[::4, 3] = 0
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    p_c = np.einsum("cij,nj->cni", T_C_S[:, :3], X)
    assert (p_c[..., 2] > 0).all()
    return X, p_c[..., :2] / p_c[..., 2:]


@pytest.mark.parametrize("views", [[0, 1], [0, 1, 2, 3]])
def test_exact_rays_give_the_exact_points(views):
    X, rays = scene()
    view, point = (index.ravel() for index in np.meshgrid(views, np.arange(len(X))))
    found = triangulate(T_C_S, view, point, rays[view, point], len(X))
    np.testing.assert_allclose(found, X, atol=1e-9)


def test_a_point_that_two_views_did_not_see_is_unknown():
    X, rays = scene()
    view, point = (index.ravel() for index in np.indices((4, len(X))))
    rows = (point != 3) | (view == 2)
    found = triangulate(T_C_S, view[rows], point[rows], rays[view[rows], point[rows]], len(X) + 1)
    assert np.array_equal(np.flatnonzero(np.isnan(found).any(1)), [3, len(X)])
