from dataclasses import replace

import numpy as np

from calm_edge.backbones.bundle import normal_equations as equations
from calm_edge.backbones.bundle import problem
from calm_edge.kit import layout
from tests.backbones.bundle.exact_window import perturbed, theta_of, turn, window


def test_rows_of_equal_keys_are_summed_and_no_rows_have_no_sums():
    some = equations.grouped(np.array([2, 0, 2, 5]))
    assert some.keys.tolist() == [0, 2, 5]
    assert some.sum(np.array([[1.0, 2, 3, 4], [0, 0, 1, 0]])).tolist() == [[2, 4, 4], [0, 1, 0]]
    none = equations.grouped(np.zeros(0, np.int64))
    assert none.sum(np.zeros((3, 4, 0))).shape == (3, 4, 0)


def test_eliminating_points_is_the_schur_complement():
    made = window(turn(3), theta_of(), n_points=25, noise_px=1.0)
    angle = np.random.default_rng(2).uniform(0, np.pi, len(made.m.uv))
    edge = 0.9 * np.stack([np.cos(angle), np.sin(angle)], 1)
    edge[::3] = 0
    m, state, ties = replace(made.m, edge=edge), perturbed(made.truth), made.ties
    # landmarks may keep a point whose observations were all dropped
    unseen = np.array([[0.0, 0.0, 1.0, 0.0]])
    state = replace(state, points=np.concatenate([state.points, unseen]))
    weight = np.random.default_rng(0).uniform(0.2, 1, len(m.uv))
    damping = 0.1
    normal = equations.normal_equations(
        state, m, ties, equations.Structure.of(m, len(state.points)), weight, damping
    )

    jac = problem.reprojection(state, m, problem.tangent_basis(state.points))
    n, points = m.n_views, len(state.points)
    D = 6 * n + layout.SIZE
    J = np.zeros((len(m.uv), 2, D + 3 * points))
    for o, (view, point) in enumerate(zip(m.view, m.point, strict=True)):
        J[o, :, 6 * view : 6 * view + 6] = jac.camera[:6, :, o].T
        J[o, :, 6 * n + layout.EYE[m.eye[view]]] = jac.camera[6:, :, o]
        J[o, :, D + 3 * point : D + 3 * point + 3] = jac.point[:, :, o].T
    W = np.eye(2) - edge[:, :, None] * edge[:, None]
    W *= (np.sqrt(weight) / m.sigma_px)[:, None, None]
    J = (W @ J).reshape(-1, D + 3 * points)
    r = (W @ (jac.predicted - m.uv)[..., None]).ravel()
    residual, tie_J = problem.tie_jacobians(state, ties)
    whole = np.zeros((len(ties.alpha), 6, D + 3 * points))
    for a in range(len(ties.alpha)):
        for k, view in enumerate((ties.before[a], ties.after[a], ties.assistant[a])):
            whole[a, :, 6 * view : 6 * view + 6] = tie_J[a, :, 6 * k : 6 * k + 6]
        whole[a, :, 6 * n :][:, layout.RIG] = tie_J[a, :, 18:24]
        whole[a, :, 6 * n + layout.TIME_OFFSET] = tie_J[a, :, 24]
    whole = whole.reshape(-1, D + 3 * points)
    A = J.T @ J + whole.T @ whole
    b = J.T @ r + whole.T @ residual.ravel()
    B, C, P = A[:D, :D], A[:D, D:], A[D:, D:]
    P = P + np.diag(damping * np.diag(P) + equations.POINT_FLOOR)
    scale = np.abs(B).max()
    assert np.allclose(normal.H, B - C @ np.linalg.solve(P, C.T), atol=1e-9 * scale)
    assert np.allclose(normal.g, b[:D] - C @ np.linalg.solve(P, b[D:]), atol=1e-9 * np.abs(b).max())
    delta = 1e-3 * np.random.default_rng(1).normal(size=D)
    step = -np.linalg.solve(P, b[D:] + C.T @ delta)
    assert np.allclose(normal.point_step(delta).ravel(), step, atol=1e-9)
