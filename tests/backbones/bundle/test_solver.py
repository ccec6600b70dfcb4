from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import problem, solver
from calm_edge.backbones.bundle.evidence import kit_evidence
from calm_edge.kit import layout
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import perturbed, theta_of, turn, window

N = 8
PRIOR = layout.prior((None, None))
VAGUE = KitBelief(PRIOR.mean, 1e-3 * PRIOR.information)
FOCALS = layout.LOG_FOCAL


def test_exact_pixels_give_back_the_truth():
    made = window(turn(N), theta_of())
    solution = solver.solve(perturbed(made.truth), made.m, made.ties, VAGUE, max_iterations=50)
    state, truth = solution.state, made.truth
    assert np.abs(state.theta - truth.theta)[FOCALS].max() < 1e-4
    assert np.abs(state.T_c_s - truth.T_c_s).max() < 1e-4
    assert np.array_equal(state.T_c_s[0], truth.T_c_s[0])
    assert np.linalg.norm(state.theta[layout.RIG_CENTRE]) == pytest.approx(1, abs=1e-12)
    assert solution.residual.max() < 1e-2


def test_gross_outliers_and_noise_leave_the_focal_within_a_percent():
    made = window(turn(N), theta_of(), noise_px=0.3, outliers=0.15)
    start = perturbed(made.truth)
    solution = solver.solve(start, made.m, made.ties, PRIOR)
    assert np.abs(solution.state.theta - made.truth.theta)[FOCALS].max() < 0.01
    assert solution.cost < solver.total_cost(
        start, solver.whitened_lengths(start, made.m), made.ties, PRIOR, 2.0
    )
    # the residuals separate the outliers
    wrong = np.linalg.norm(problem.project(made.truth, made.m)[0] - made.m.uv, axis=1) > 3
    assert 0.1 < wrong.mean() < 0.16
    assert (solution.residual[wrong] > 4).mean() > 0.95
    assert (solution.residual[~wrong] < 4).mean() > 0.95


def test_a_prior_determines_the_directions_that_pixels_do_not():
    made = window(turn(N, yaw_rad=0.0), theta_of())
    mean = made.truth.theta.copy()
    mean[FOCALS] += 0.05
    sure = KitBelief(mean, layout.prior((76.0, 66.0)).information)
    solution = solver.solve(made.truth, made.m, made.ties, sure)
    assert solution.state.theta[FOCALS] == pytest.approx(mean[FOCALS], abs=0.01)


def test_a_point_started_in_a_view_does_not_stop_the_solver():
    made = window(turn(N), theta_of())
    start = perturbed(made.truth)
    T_s_c = np.linalg.inv(start.T_c_s)
    seen_by = [made.m.view[made.m.point == point] for point in (0, 1)]
    # one exactly at a camera's centre, one a hair before its plane
    start.points[0] = T_s_c[seen_by[0][0], :, 3]
    start.points[1] = T_s_c[seen_by[1][0]] @ [0.5, 0.1, 1e-7, 1]
    start.points[:2] /= np.linalg.norm(start.points[:2], axis=1, keepdims=True)
    solution = solver.solve(start, made.m, made.ties, PRIOR, max_iterations=50)
    assert np.isfinite(solution.cost) and np.isfinite(solution.state.points).all()
    assert np.abs(solution.state.theta - made.truth.theta)[FOCALS].max() < 0.01
    information = kit_evidence(solution, made.m, made.ties, 2.0).information
    assert np.isfinite(information).all()


def test_a_step_that_lengthens_the_rig_rescales_the_scene_instead():
    made = window(turn(3), theta_of(), n_points=25)
    n = made.m.n_views
    delta = np.zeros(6 * n + layout.SIZE)
    delta[6 * n :][layout.RIG_CENTRE] = 0.25 * made.truth.theta[layout.RIG_CENTRE]
    still = np.zeros((len(made.truth.points), 3))
    state = solver._step(made.truth, n, delta, still)
    assert np.allclose(state.theta, made.truth.theta)
    assert np.allclose(state.T_c_s[:, :3, 3] * 1.25, made.truth.T_c_s[:, :3, 3])
    assert np.allclose(problem.project(state, made.m)[0], made.m.uv)


def test_an_outlier_costs_no_more_the_farther_it_is():
    made = window(turn(3), theta_of(), n_points=25)
    made.m.uv[:3] += [[1.5, 2.0], [49.0, 0], [900.0, 0]]
    made.truth.points[made.m.point[-1]] *= -1
    behind = made.m.point == made.m.point[-1]
    length = solver.whitened_lengths(made.truth, made.m)
    assert length[:3] == pytest.approx([5, 98, 100])
    assert (length[behind] == 100).all() and length[3:][~behind[3:]].max() < 1e-6


def slid_along_edges(made, slide_px, seed=0):
    """The window with most of its points on edges, along which matches slide further every view."""
    rng = np.random.default_rng(seed)
    m = made.m
    on_edge = rng.random(len(made.truth.points)) < 0.7
    angle = rng.uniform(-1.2, 1.2, len(on_edge))[m.point]
    direction = np.stack([np.cos(angle), np.sin(angle)], 1) * on_edge[m.point][:, None]
    direction[np.unique(m.point, return_index=True)[1]] = 0
    uv = m.uv + direction * (slide_px * (m.view % N))[:, None]
    return replace(m, uv=uv, edge=direction * np.sqrt(1 - 1 / 100))


def test_matches_that_slid_along_edges_count_across_them():
    made = window(turn(N), theta_of(), noise_px=0.2)
    m = slid_along_edges(made, 0.7)
    start = perturbed(made.truth)
    known, blind = (
        solver.solve(start, each, made.ties, PRIOR, max_iterations=50)
        for each in (m, replace(m, edge=None))
    )
    errors = [
        np.abs(found.state.T_c_s - made.truth.T_c_s)[:, :3, 3].max() for found in (known, blind)
    ]
    assert errors[0] < 0.1 and errors[0] < errors[1] / 2
