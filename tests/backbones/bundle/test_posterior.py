"""Posterior sigmas of a window against the scatter of windows measured anew."""

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import posterior, solver
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import theta_of, turn, window

N = 5
TRIALS = 40
SCALE = 2.0
STIFFNESS = 2.0


def known(sigma=1e-3):
    """A prior on the kit that is as sure of every term as `sigma`, around the truth."""
    return np.full(layout.SIZE, sigma) ** -2.0


def prior_of(theta, information):
    return KitBelief(theta, STIFFNESS * np.diag(information))


def path(state):
    return np.linalg.norm(np.diff(se3.inverse(state.T_c_s[:N])[:, :3, 3], axis=0), axis=1).sum()


def trials(monkeypatch, per_track_px, kit_sigma):
    """Errors of log length and of the last pose's motion, and their claimed sigmas.

    Each track has an offset of its own in each eye; the prior's mean is off as it claims.
    """
    monkeypatch.setattr(posterior, "CELLS_ALIKE", 1.0)
    monkeypatch.setattr(posterior, "COMMON_SHARE", 0.0)
    made = window(turn(N), theta_of(), n_points=250, delay_s=0.0)
    rng, m = np.random.default_rng(5), made.m
    information = known(kit_sigma)
    errors, sigmas = [], []
    for _ in range(TRIALS):
        offset = per_track_px * rng.standard_normal((m.point.max() + 1, 2, 2))
        uv = m.uv + offset[m.point, m.eye[m.view]] + 0.05 * rng.standard_normal(m.uv.shape)
        noisy = replace(m, uv=uv)
        theta = made.truth.theta + kit_sigma * rng.standard_normal(layout.SIZE)
        theta[layout.RIG_CENTRE] /= np.linalg.norm(theta[layout.RIG_CENTRE])
        prior = prior_of(theta, information)
        solved = solver.solve(made.truth, noisy, made.ties, prior, robust_scale=SCALE)
        held = posterior.posterior(solved, noisy, made.ties, prior, SCALE, STIFFNESS)
        last = se3.log(made.truth.T_c_s[N - 1] @ se3.inverse(solved.state.T_c_s[N - 1]))
        errors.append([np.log(path(solved.state) / path(made.truth)), last[2]])
        along = np.sqrt(held.of_views(np.array([N - 1]))[2, 2])
        sigmas.append([held.scale_log_sigma(solved.state, noisy), along])
    return np.array(errors), np.array(sigmas)


@pytest.mark.parametrize(("per_track_px", "kit_sigma"), [(0.3, 1e-6), (0.01, 5e-3)])
def test_errors_have_the_claimed_sigma(monkeypatch, per_track_px, kit_sigma):
    errors, sigmas = trials(monkeypatch, per_track_px, kit_sigma)
    rms = np.sqrt(((errors / sigmas) ** 2).mean(0))
    # an rms over 40 has a sigma of 11 %
    assert (rms > 0.7).all() and (rms < 1.35).all()


def solved(T_s_p):
    """A window whose kit is all but known, solved; and the arguments of `posterior`."""
    made = window(T_s_p, theta_of(), noise_px=0.1)
    prior = prior_of(made.truth.theta, layout.prior((76.0, 66.0)).information.diagonal())
    solution = solver.solve(made.truth, made.m, made.ties, prior, robust_scale=0.5)
    return solution, made.m, made.ties, prior, 0.5, STIFFNESS


def scale_sigma(window):
    solution, m = window[:2]
    return posterior.posterior(*window).scale_log_sigma(solution.state, m)


def test_a_standing_car_has_no_scale():
    assert scale_sigma(solved(turn(N))) < 0.1
    assert scale_sigma(solved(np.tile(np.eye(4), (N, 1, 1)))) > 1


def test_a_shared_error_of_parallax_is_one_of_scale(monkeypatch):
    made = solved(turn(N))
    alone = scale_sigma(made)
    # 5 % of every parallax: below NEAR_PX the error is proportional to it
    median_px = np.median(made[0].residual * made[1].sigma_px)
    monkeypatch.setattr(posterior, "NEAR_PX", 1e4)
    monkeypatch.setattr(posterior, "COMMON_SHARE", 0.05 * 1e4 / median_px)
    assert scale_sigma(made) == pytest.approx(np.hypot(alone, 0.05), rel=0.02)


def test_wrong_matches_are_left_out(monkeypatch):
    """Points near a camera move by any length with it, however little their matches count."""
    solution, m, *rest = solved(turn(N))
    alone = scale_sigma((solution, m, *rest))
    state, points = solution.state, solution.state.points.copy()
    # beyond infinity, as the solver leaves points whose rays diverge
    near = np.append(se3.inverse(state.T_c_s[0])[:3] @ [0.01, 0.0, 0.02, -1.0], -1.0)
    points[np.unique(m.point[m.view == 0])[:40]] = near / np.linalg.norm(near)
    wrong = replace(state, points=points)
    spoilt = solver.Solution(wrong, 0.0, solver.whitened_lengths(wrong, m))
    left_out = scale_sigma((spoilt, m, *rest))
    monkeypatch.setattr(posterior, "LEAST_WEIGHT", 0.0)
    counted = scale_sigma((spoilt, m, *rest))
    # forty tracks are lost, which makes it a little wider
    assert alone < left_out < 1.05 * alone
    assert counted > 1.01 * left_out


def test_a_bend_of_the_picture_is_an_error_of_straight_roads(monkeypatch):
    """It looks like another focal: not where the car turns, nor where the kit is known."""

    def widened(yaw_rad, information):
        made = window(turn(N, yaw_rad), theta_of(), noise_px=0.1)
        prior = prior_of(made.truth.theta, information)
        solution = solver.solve(made.truth, made.m, made.ties, prior, robust_scale=0.5)
        sigmas = []
        for most in (0.3, 0.0):
            monkeypatch.setattr(posterior, "MOST_BENT", most)
            sigmas.append(scale_sigma((solution, made.m, made.ties, prior, 0.5, STIFFNESS)))
        return np.sqrt(sigmas[0] ** 2 - sigmas[1] ** 2)

    guessed = layout.prior((None, None)).information.diagonal()
    straight = widened(1e-3, guessed)
    assert straight > 0.02
    assert widened(0.07, guessed) < 0.1 * straight
    assert widened(1e-3, known(1e-4)) < 0.1 * straight
