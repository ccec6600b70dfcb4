from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import problem, solver, stamps
from calm_edge.kit import layout
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import DELAY_S, perturbed, theta_of, turn, window

N = 12
JITTER_S = 0.01  # a tenth of a spacing at 10 spacings a second


def known(theta):
    """A belief as precise as after some windows."""
    sigma = np.full(layout.SIZE, 0.003)
    sigma[layout.OPTICS] = 0.01, 5e-3, 5e-3, 3e-4, 3e-4
    sigma[layout.RIG_CENTRE] = 0.1
    return KitBelief(theta.copy(), np.diag(sigma**-2.0))


def host_jitters(seed=0):
    """Exposures at a fixed rate with jitter in the stamps of both eyes."""
    made = window(turn(N), theta_of(), noise_px=0.2, seed=seed)
    noise = np.random.default_rng(seed).normal(0, JITTER_S, 2 * N)
    return replace(made, m=replace(made.m, t=made.m.t + noise))


def camera_jitters(seed=0):
    """An assistant with irregular exposures and true stamps."""
    delay_s = DELAY_S + np.random.default_rng(seed).normal(0, JITTER_S, N)
    return window(turn(N), theta_of(), noise_px=0.2, delay_s=delay_s, seed=seed)


def solved(made, timed, start=None):
    start = start or perturbed(made.truth, pose=0.01, focal=0.0)
    ties = timed(made.ties, start)
    return solver.solve(start, made.m, ties, known(made.truth.theta), robust_scale=2.0).state


def in_two_steps(made):
    return solved(made, stamps.corrected, solved(made, stamps.freed))


def off(made, state):
    """Rms distance of the assistants from where they were, spacings."""
    there = np.linalg.inv(state.T_c_s)[N:, :3, 3] - np.linalg.inv(made.truth.T_c_s)[N:, :3, 3]
    return float(np.sqrt((there**2).sum(1).mean()))


@pytest.mark.parametrize("seed", range(3))
def test_pixels_separate_host_delay_from_irregular_exposure(seed):
    for made, theirs in ((host_jitters(seed), 1.0), (camera_jitters(seed), 0.0)):
        share, sigma = stamps.delay_share(made.ties, solved(made, stamps.freed))
        assert share == pytest.approx(theirs, abs=0.2)
        assert sigma < 0.35


def test_jitter_of_stamps_distorts_the_window_less():
    made = host_jitters()
    trusting = solved(made, lambda ties, _: ties)
    assert off(made, in_two_steps(made)) < 0.5 * off(made, trusting)


def test_an_irregular_exposure_keeps_its_stamp():
    made = camera_jitters()
    trusting = solved(made, lambda ties, _: ties)
    assert off(made, in_two_steps(made)) < 1.1 * off(made, trusting)


def test_stamps_are_kept_at_standstill():
    made = window(np.tile(np.eye(4), (N, 1, 1)), theta_of(), noise_px=0.2)
    noise = np.random.default_rng(0).normal(0, JITTER_S, 2 * N)
    ties = replace(made, m=replace(made.m, t=made.m.t + noise)).ties
    _, sigma = stamps.delay_share(ties, made.truth)
    assert sigma > 10
    assert stamps.irregular(ties)
    assert stamps.corrected(ties, made.truth) is ties


def test_regular_stamps_are_kept():
    made = window(turn(N), theta_of())
    ties = made.ties
    assert not stamps.irregular(ties)
    assert stamps.freed(ties, made.truth) is ties
    assert stamps.corrected(ties, made.truth) is ties
    # too few for a frame rate
    few = window(turn(4), theta_of(), n_points=20)
    assert not stamps.irregular(few.ties)


def whitener(ties):
    """(A, 6, 6) that whitened() multiplies a residual by."""
    return ties.whitened(np.eye(6)[:, None] * np.ones((6, N, 6))).transpose(1, 2, 0)


def test_a_corrected_tie_has_the_covariance_of_its_instant():
    made = host_jitters()
    state = solved(made, stamps.freed)
    ties, corrected = made.ties, stamps.corrected(made.ties, state)
    share, sigma = stamps.delay_share(ties, state)
    assert np.allclose(corrected.late_s, -share * ties.jitter_s)
    assert np.allclose(corrected.alpha, ties.alpha + ties.rate * corrected.late_s)
    # the common offset of twelve frames
    shared = share * np.sqrt(np.mean(ties.jitter_s**2) / N)
    assert stamps.common_sigma_s(corrected) == pytest.approx(shared)
    assert stamps.common_sigma_s(ties) == 0
    _, J = problem.tie_jacobians(state, replace(corrected, along=np.zeros((N, 6))))
    root = ties.information_root
    d = sigma * np.sqrt(np.mean(ties.jitter_s**2)) * J[..., -1] / root
    for a, W in enumerate(whitener(corrected)):
        covariance = np.diag(root[a] ** -2) + np.outer(d[a], d[a])
        assert np.allclose(W.T @ W @ covariance, np.eye(6), atol=1e-6)


def test_a_freed_tie_is_soft_along_the_path_only():
    made = host_jitters()
    freed = stamps.freed(made.ties, made.truth)
    spread = np.sqrt(np.mean(made.ties.jitter_s**2))
    _, J = problem.tie_jacobians(made.truth, made.ties)
    along = np.linalg.norm(J[..., -1], axis=1)
    _, J = problem.tie_jacobians(made.truth, freed)
    assert np.allclose(np.linalg.norm(J[..., -1], axis=1), 1 / np.hypot(spread, 1 / along))
    for W, d, root in zip(whitener(freed), freed.along, freed.information_root, strict=True):
        across = np.linalg.svd(d[None])[2][1:]  # whatever is orthogonal to d
        assert np.allclose(across @ (W / root), across)


def test_derivatives_of_corrected_ties_predict_a_step():
    made = host_jitters()
    state = perturbed(made.truth, pose=0.003)
    ties = stamps.corrected(made.ties, state)
    residual, J = problem.tie_jacobians(state, ties)
    later = state.theta.copy()
    later[layout.TIME_OFFSET] += 1e-6
    change = problem.tie_jacobians(replace(state, theta=later), ties)[0] - residual
    assert np.allclose(J[..., -1] * 1e-6, change, atol=1e-3 * np.abs(change).max())
