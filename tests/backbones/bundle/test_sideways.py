"""Prior on the direction of motion: its derivatives, what it costs, and what it rules out."""

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import solver
from calm_edge.backbones.bundle.motion import motion_prior
from calm_edge.backbones.bundle.sideways import sideways_prior
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import theta_of, window

N = 8
# by how far the nearest points are drawn aside from one keyframe to the next, px
DRIFT_PX = 0.8
AHEAD = np.array([0.0, 0.0, 1.0])


def path(step, n=N):
    """The camera moves by the same twist from each keyframe to the next."""
    T = [np.eye(4)]
    for _ in range(n - 1):
        T.append(T[-1] @ se3.exp(np.asarray(step, np.float64)))
    return np.array(T)


def cost(step, travel=AHEAD):
    made = window(path(step), theta_of(), n_points=25, delay_s=0.0)
    return sideways_prior(made.m, travel).cost(made.truth)


def test_derivatives_are_those_of_the_residuals():
    made = window(path([0.4, 0.1, 3.0, 0, 0, 0]), theta_of(), n_points=25)
    prior, T = sideways_prior(made.m, np.array([0.6, 0.0, 0.8])), made.truth.T_c_s
    residual, J = prior.linearised(T)
    assert prior.cost(made.truth) == pytest.approx(residual @ residual)
    numeric = np.zeros_like(J)
    for k in range(J.shape[1]):
        twist = np.zeros((made.m.n_views, 6))
        twist[k // 6, k % 6] = 1e-6
        ahead, behind = (prior.linearised(se3.exp(s * twist) @ T)[0] for s in (1, -1))
        numeric[:, k] = (ahead - behind) / 2e-6
    assert np.abs(numeric).max() > 1 and np.allclose(J, numeric, atol=1e-6)


def test_only_motion_across_the_direction_of_travel_costs():
    assert cost([0, 0, 3.0, 0, 0, 0]) < 1e-12
    assert cost([0, 0, -3.0, 0, 0, 0]) < 1e-12, "a car that reverses moves along the same axis"
    assert cost([3.0, 0, 0.3, 0, 0, 0]) > 50
    assert cost([3.0, 0, 3.0, 0, 0, 0], np.array([1.0, 0, 1]) / 2**0.5) < 1e-12
    # six degrees of camber are a sigma, and any mounting is possible where nothing is known
    assert cost([0.3, 0, 3.0, 0, 0, 0]) < 2
    assert cost([3.0, 0, 3.0, 0, 0, 0], None) < 2


def test_a_camera_ahead_of_the_rear_axle_moves_sideways_in_turns():
    aside = [0.9, 0, 3.0, 0, 0, 0]
    turning = [0.9, 0, 3.0, 0, 0.2, 0]
    assert cost(turning) < 0.3 * cost(aside)


def test_it_rules_out_a_slide_where_all_points_are_far():
    """A drift of nearer points against farther ones looks like a step to the side."""
    made = window(path([0, 0, 0.3, 0, 0, 0]), theta_of(), n_points=60, noise_px=0.1, seed=4)
    nearness = 150 * made.truth.points[made.m.point, 3]
    rows = {k: getattr(made.m, k)[nearness < 1] for k in ("view", "point", "uv", "sigma_px")}
    time = made.m.t[rows["view"]] / np.diff(made.m.t)[0]
    rows["uv"] = rows["uv"] + np.c_[DRIFT_PX * time * nearness[nearness < 1], np.zeros(len(time))]
    m = replace(made.m, **rows)
    kit = layout.prior((76.0, 66.0))

    def directions(*priors):
        found = solver.solve(
            made.truth, m, made.ties, KitBelief(kit.mean, 50 * kit.information),
            pose_priors=(motion_prior(m, 50.0), *priors), robust_scale=0.5,
        )  # fmt: skip
        T = found.state.T_c_s[m.eye == 0]
        step = (T[:-1] @ se3.inverse(T[1:]))[:, :3, 3]
        return np.degrees(np.arctan2(np.hypot(step[:, 0], step[:, 1]), step[:, 2]))

    assert directions().max() > 30
    assert directions(sideways_prior(m, AHEAD)).max() < 10
