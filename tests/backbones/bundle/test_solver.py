from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest

from calm_edge.backbones.bundle import problem, solver
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import perturbed, theta_of, turn, window

N = 8
PRIOR = layout.prior((None, None))
VAGUE = KitBelief(PRIOR.mean, 1e-3 * PRIOR.information)
FOCALS = layout.LOG_FOCAL


def evidence(made, tempering=1.0):
    """Evidence of a window measured with noise, solved from its truth."""
    solution = solver.solve(made.truth, made.m, made.ties, PRIOR)
    return solver.kit_evidence(solution, made.m, made.ties, 2.0, tempering)


def sigma(*beliefs):
    return np.sqrt(np.diag(np.linalg.inv(product([PRIOR, *beliefs]).information)))


@pytest.fixture(scope="module")
def curved():
    return evidence(window(turn(N), theta_of(), noise_px=0.3))


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
    assert solution.cost < solver.total_cost(start, made.m, made.ties, PRIOR, 2.0)
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
    information = solver.kit_evidence(solution, made.m, made.ties, 2.0, 1.0).information
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


def test_a_turn_determines_the_focal_and_a_straight_drive_does_not(curved):
    straight = evidence(window(turn(N, yaw_rad=0.0), theta_of(), noise_px=0.3))
    assert sigma(curved)[FOCALS].max() < 0.01
    # both focals can still change together
    assert sigma(straight)[FOCALS].min() > 0.1
    u = np.zeros(layout.SIZE)
    u[FOCALS] = np.sqrt(0.5)
    others = np.delete(np.arange(layout.SIZE), FOCALS)

    def along_focal(belief):
        A = belief.information + 1e-6 * np.eye(layout.SIZE)
        cross = A[others] @ u
        return u @ A @ u - cross @ np.linalg.solve(A[np.ix_(others, others)], cross)

    assert along_focal(straight) < 1e-3 * along_focal(curved)


def test_evidence_is_a_proper_gaussian_around_the_truth(curved):
    truth = theta_of()
    assert np.allclose(curved.information, curved.information.T, rtol=1e-12)
    values = np.linalg.eigvalsh(curved.information)
    assert values[0] > -1e-9 * values[-1]
    off = curved.mean - truth
    # 15 numbers: their squared distance in sigmas is a chi square
    assert 0.1 < off @ curved.information @ off < 40
    assert np.abs(off[FOCALS]).max() < 0.01


def test_evidence_excludes_the_prior():
    made = window(turn(N), theta_of(), noise_px=0.3)
    mean = made.truth.theta.copy()
    mean[FOCALS] += 0.01
    sure = KitBelief(mean, layout.prior((76.0, 66.0)).information)
    pulled = solver.solve(made.truth, made.m, made.ties, sure)
    free = solver.solve(made.truth, made.m, made.ties, PRIOR)
    beliefs = [solver.kit_evidence(s, made.m, made.ties, 2.0, 1.0) for s in (pulled, free)]
    moved = np.abs(pulled.state.theta - free.state.theta)[FOCALS]
    apart = np.abs(beliefs[0].mean - beliefs[1].mean)[FOCALS]
    assert (moved > 3e-4).all() and (apart < 0.3 * moved).all()


def test_evidence_includes_the_last_step_to_the_optimum():
    """It holds from any state near the optimum, so the solver may stop a little early."""
    made = window(turn(N), theta_of())
    start = perturbed(made.truth, pose=3e-4, focal=3e-4)
    solution = solver.Solution(start, 0.0, solver.whitened_lengths(start, made.m))
    belief = solver.kit_evidence(solution, made.m, made.ties, 1e3, 1.0)
    off, was_off = (np.abs(theta - made.truth.theta) for theta in (belief.mean, start.theta))
    assert off[FOCALS].max() < 0.2 * was_off[FOCALS].max()
    assert off[layout.RIG_ROTATION].max() < 0.2 * was_off[layout.RIG_ROTATION].max()


def test_tempering_scales_the_information_and_not_the_mean(curved):
    weak = evidence(window(turn(N), theta_of(), noise_px=0.3), tempering=0.02)
    assert np.allclose(weak.information, 0.02 * curved.information, rtol=1e-9)
    assert np.array_equal(weak.mean, curved.mean)


def test_a_second_window_halves_the_variance(curved):
    other = evidence(window(turn(N), theta_of(), noise_px=0.3, seed=5))
    ratio = (sigma(curved, other) / sigma(curved))[FOCALS] ** 2
    assert (ratio > 0.35).all() and (ratio < 0.65).all()


def changing_speed(n):
    """T_s_p (n, 4, 4): steps of 1 to 5 spacings, gently turning."""
    steps = np.zeros((n - 1, 6))
    steps[:, 2] = 3 + 2 * np.sin(np.arange(n - 1) / 2)
    steps[:, 4] = 0.02
    return np.concatenate([[np.eye(4)], np.array(list(accumulate(se3.exp(steps), np.matmul)))])


def test_the_time_offset_is_observable_where_the_speed_changes_only():
    theta = theta_of()
    theta[layout.TIME_OFFSET] = 0.02
    sigmas = []
    for T_s_p in (
        changing_speed(N),
        np.array([se3.exp(np.array([0, 0, 3.0 * k, 0, 0, 0])) for k in range(N)]),
    ):
        made = window(T_s_p, theta, noise_px=0.3, delay_s=0.0)
        start = replace(made.truth, theta=theta_of())
        solution = solver.solve(start, made.m, made.ties, PRIOR)
        belief = product([PRIOR, solver.kit_evidence(solution, made.m, made.ties, 2.0, 1.0)])
        sigmas.append(
            np.sqrt(np.linalg.inv(belief.information)[layout.TIME_OFFSET, layout.TIME_OFFSET])
        )
        assert abs(belief.mean[layout.TIME_OFFSET] - 0.02) < 4 * sigmas[-1]
    assert (
        sigmas[0] < 0.3 * layout.TIME_OFFSET_SIGMA_S
        and sigmas[1] > 0.8 * layout.TIME_OFFSET_SIGMA_S
    )
