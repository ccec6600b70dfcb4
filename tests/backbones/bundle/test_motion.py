"""Motion prior: its derivatives, and what it costs a car that turns, brakes or stands."""

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import motion, solver
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import theta_of, turn, window

N = 6
FACTOR = 50.0


def prior_of(m, factor=1.0):
    return motion.motion_prior(m, factor)


def moved(state, twist):
    return replace(state, T_c_s=se3.exp(twist) @ state.T_c_s)


def test_derivatives_are_those_of_the_residuals():
    made = window(turn(N, yaw_rad=0.2), theta_of(), n_points=25)
    t = made.m.t.copy()
    t[2] += 0.07
    prior, state = prior_of(replace(made.m, t=t), 3.0), made.truth
    residual, J = prior.linearised(state.T_c_s)
    assert np.allclose(residual, prior.residuals(state.T_c_s), atol=1e-12)
    numeric = np.zeros_like(J)
    for k in range(J.shape[1]):
        twist = np.zeros((made.m.n_views, 6))
        twist[k // 6, k % 6] = 1e-6
        ahead, behind = (prior.residuals(moved(state, s * twist).T_c_s) for s in (1, -1))
        numeric[:, k] = (ahead - behind) / 2e-6
    assert np.abs(numeric).max() > 1 and np.allclose(J, numeric, atol=1e-6)


def test_it_is_added_at_the_rows_of_its_views():
    made = window(turn(N), theta_of(), n_points=25)
    prior, state = prior_of(made.m), made.truth
    n = made.m.n_views
    H, g = np.zeros((6 * n + layout.SIZE,) * 2), np.zeros(6 * n + layout.SIZE)
    prior.add_to(H, g, state)
    delta = np.zeros(len(g))
    delta[: 6 * n] = 1e-4 * np.random.default_rng(0).standard_normal(6 * n)
    twist = delta[: 6 * n].reshape(-1, 6)
    ahead, behind = (prior.cost(moved(state, s * twist)) for s in (1, -1))
    assert ahead - behind == pytest.approx(4 * g @ delta, rel=1e-5)
    assert ahead + behind - 2 * prior.cost(state) == pytest.approx(2 * delta @ H @ delta, rel=0.05)


def straight(speeds, dt=0.3):
    """A primary that drives along z with these speeds [spacings / s]."""
    T_s_p = np.tile(np.eye(4), (len(speeds) + 1, 1, 1))
    T_s_p[1:, 2, 3] = dt * np.cumsum(speeds)
    return T_s_p


def test_a_steady_turn_costs_nothing_and_a_jump_of_the_velocity_much():
    arc = [np.eye(4)]
    for _ in range(N - 1):
        arc.append(arc[-1] @ se3.exp(np.array([0.1, 0, 3.0, 0, 0.2, 0])))
    made = window(np.array(arc), theta_of(), n_points=25, delay_s=0.0)
    assert np.allclose(prior_of(made.m).residuals(made.truth.T_c_s), 0, atol=1e-9)
    # a jump costs far more than the same change of speed spread over the window
    costs = []
    for speeds in ([8, 8, 8, 8, 12, 12, 12, 12], np.linspace(8, 12, 8)):
        made = window(straight(speeds), theta_of(), n_points=25)
        costs.append(prior_of(made.m).cost(made.truth))
    assert costs[0] > 8 * costs[1] > 0
    # steady acceleration counts about once, however many keyframes show it
    speed = np.mean(np.linspace(8, 12, 8) ** 4) ** 0.25
    share = 4 / 7 / 0.3 / speed / motion.ACCELERATION_SIGMA
    assert share**2 < costs[1] < 2 * share**2
    # lengths have no unit here: a prior on accelerations would favour small ones
    larger = made.truth.T_c_s.copy()
    larger[:, :3, 3] *= 40
    larger = replace(made.truth, T_c_s=larger)
    assert prior_of(made.m).cost(larger) == pytest.approx(costs[1])


def test_irregular_stamps_loosen_it():
    made = window(straight([8, 8, 8, 8, 12, 12, 12, 12]), theta_of(), n_points=25)
    off = 0.02 * np.random.default_rng(0).standard_normal(made.m.n_views)
    shaken = replace(made.m, t=made.m.t + off)
    regular, loose = (prior_of(m).cost(made.truth) for m in (made.m, shaken))
    assert loose < 0.5 * regular


def test_two_keyframes_have_no_change_of_velocity():
    made = window(turn(2), theta_of(), n_points=60)
    assert prior_of(made.m).cost(made.truth) == 0
    solution = solver.solve(
        made.truth, made.m, made.ties, layout.prior((None, None)), pose_priors=(prior_of(made.m),)
    )
    assert np.isfinite(solution.cost)


def solved_steps(made, *priors):
    """Lengths of the steps, solved from the truth; all priors count as against pixels."""
    kit = layout.prior((76.0, 66.0))
    solution = solver.solve(
        made.truth, made.m, made.ties, KitBelief(kit.mean, FACTOR * kit.information),
        pose_priors=priors, robust_scale=0.5, max_iterations=40, tolerance=1e-6,
    )  # fmt: skip
    return np.diff(se3.inverse(solution.state.T_c_s[made.m.eye == 0])[:, 2, 3])


def test_it_gives_way_where_pictures_inform():
    # full braking, a stop, full throttle: 6 and 3 m/s^2 at 0.5 m between the cameras
    speeds = np.array([20.0, 16.0, 12.0, 8.0, 4.0, 0.0, 0.0, 2.0, 4.0])
    made = window(straight(speeds), theta_of(), noise_px=0.3, seed=2)
    free = solved_steps(made)
    held = solved_steps(made, prior_of(made.m, FACTOR))
    assert np.abs(free - 0.3 * speeds).max() < 0.05
    assert np.abs(held - free).max() < 0.05


def test_it_holds_steps_that_pictures_leave_open():
    """An instant at which both cameras see far points only takes its place from its neighbours."""
    made = window(straight(np.full(7, 20.0)), theta_of(), noise_px=1.0, seed=3)
    far = made.truth.points[made.m.point, 3] < 1 / 250
    kept = ~np.isin(made.m.view, [3, 8 + 3]) | far
    rows = {k: getattr(made.m, k)[kept] for k in ("view", "point", "uv", "sigma_px")}
    blind = replace(made, m=replace(made.m, **rows))
    free, held = solved_steps(blind), solved_steps(blind, prior_of(blind.m, FACTOR))
    assert np.abs(free - 6)[2:4].max() > 0.15
    assert np.abs(held - 6)[2:4].max() < 0.05
