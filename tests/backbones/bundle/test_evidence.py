from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest

from calm_edge.backbones.bundle import evidence as module
from calm_edge.backbones.bundle import solver
from calm_edge.backbones.bundle.evidence import kit_evidence
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.belief import covariance, gaussian, product
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import perturbed, theta_of, turn, window

N = 8
PRIOR = layout.prior((None, None))
FOCALS = layout.LOG_FOCAL


def evidence(made):
    """Evidence of a window measured with noise, solved from its truth."""
    solution = solver.solve(made.truth, made.m, made.ties, PRIOR)
    return kit_evidence(solution, made.m, made.ties, 2.0)


def sigma(*beliefs):
    return np.sqrt(np.diag(covariance(product([PRIOR, *beliefs]))))


@pytest.fixture(scope="module")
def curved():
    return evidence(window(turn(N), theta_of(), noise_px=0.3))


def test_a_turn_determines_the_focal_and_a_straight_drive_does_not(curved):
    straight = evidence(window(turn(N, yaw_rad=0.0), theta_of(), noise_px=0.3))
    assert sigma(curved)[FOCALS].max() < 0.011
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
    # 17 numbers: their squared distance in sigmas is a chi square
    known = gaussian(curved).information
    assert 0.1 < off @ known @ off < 40
    assert np.abs(off[FOCALS]).max() < 0.01


def test_evidence_excludes_the_prior():
    made = window(turn(N), theta_of(), noise_px=0.3)
    mean = made.truth.theta.copy()
    mean[FOCALS] += 0.01
    sure = KitBelief(mean, layout.prior((76.0, 66.0)).information)
    pulled = solver.solve(made.truth, made.m, made.ties, sure)
    free = solver.solve(made.truth, made.m, made.ties, PRIOR)
    beliefs = [kit_evidence(s, made.m, made.ties, 2.0) for s in (pulled, free)]
    moved = np.abs(pulled.state.theta - free.state.theta)[FOCALS]
    apart = np.abs(beliefs[0].mean - beliefs[1].mean)[FOCALS]
    assert (moved > 3e-4).all() and (apart < 0.3 * moved).all()


def test_evidence_includes_the_last_step_to_the_optimum():
    """It holds from any state near the optimum, so the solver may stop a little early."""
    made = window(turn(N), theta_of())
    start = perturbed(made.truth, pose=3e-4, focal=3e-4)
    solution = solver.Solution(start, 0.0, solver.whitened_lengths(start, made.m))
    belief = kit_evidence(solution, made.m, made.ties, 1e3)
    off, was_off = (np.abs(theta - made.truth.theta) for theta in (belief.mean, start.theta))
    assert off[FOCALS].max() < 0.2 * was_off[FOCALS].max()
    assert off[layout.RIG_ROTATION].max() < 0.2 * was_off[layout.RIG_ROTATION].max()


def test_a_second_window_halves_the_variance_of_what_is_not_common(curved):
    other = evidence(window(turn(N), theta_of(), noise_px=0.3, seed=5))
    curved, other = (replace(one, common=0.0) for one in (curved, other))
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
        belief = product([PRIOR, kit_evidence(solution, made.m, made.ties, 2.0)])
        sigmas.append(np.sqrt(covariance(belief)[layout.TIME_OFFSET, layout.TIME_OFFSET]))
        assert abs(belief.mean[layout.TIME_OFFSET] - 0.02) < 4 * sigmas[-1]
    assert (
        sigmas[0] < 0.3 * layout.TIME_OFFSET_SIGMA_S
        and sigmas[1] > 0.8 * layout.TIME_OFFSET_SIGMA_S
    )


def several(T_s_p, theta, seeds=range(12), **noise):
    """Errors in log focal and their sigmas of windows that differ by their noise alone."""
    made = [window(T_s_p, theta, seed=seed, **noise) for seed in seeds]
    found = [evidence(one) for one in made]
    error = np.array([product([PRIOR, one]).mean[FOCALS[0]] - theta[FOCALS[0]] for one in found])
    return error, np.array([sigma(one)[FOCALS[0]] for one in found])


@pytest.mark.parametrize("noise_px", [0.1, 0.4])
def test_the_sigma_is_that_of_the_errors_whatever_the_noise(noise_px, monkeypatch):
    monkeypatch.setattr(module, "COMMON", 0.0)
    monkeypatch.setattr(module, "BIAS_PX", 1e-9)
    error, claimed = several(turn(N), theta_of(), noise_px=noise_px)
    assert 0.6 < np.sqrt(((error / claimed) ** 2).mean()) < 1.6


def drifting(made, share, rng):
    """The measurements with one error a point and eye besides, of `share` px."""
    key = 2 * made.m.point + made.m.eye[made.m.view]
    error = share * rng.standard_normal((key.max() + 1, 2))
    return replace(made, m=replace(made.m, uv=made.m.uv + error[key]))


def test_errors_that_a_track_shares_count_as_one(monkeypatch):
    monkeypatch.setattr(module, "COMMON", 0.0)
    monkeypatch.setattr(module, "BIAS_PX", 1e-9)
    rng = np.random.default_rng(1)
    made = [window(turn(N), theta_of(), noise_px=0.05, seed=seed) for seed in range(12)]
    found = [evidence(drifting(one, 0.3, rng)) for one in made]
    off = np.array([product([PRIOR, one]).mean[FOCALS[0]] for one in found]) - theta_of()[FOCALS[0]]
    claimed = np.array([sigma(one)[FOCALS[0]] for one in found])
    assert 0.5 < np.sqrt(((off / claimed) ** 2).mean()) < 1.7


def common_sigma(*beliefs):
    """Part of the sigma of log focal that is common to all evidence."""
    alone = [replace(one, common=0.0) for one in beliefs]
    return np.sqrt(sigma(*beliefs)[FOCALS[0]] ** 2 - sigma(*alone)[FOCALS[0]] ** 2)


def test_the_common_part_never_averages_out_and_is_small_in_a_turn():
    turning = evidence(window(turn(N), theta_of(), noise_px=0.1))
    gentle = evidence(window(turn(N, yaw_rad=0.01), theta_of(), noise_px=0.1))
    assert 0 < common_sigma(turning) < 0.5 * common_sigma(gentle)
    assert common_sigma(*[turning] * 400) == pytest.approx(common_sigma(turning), rel=0.25)


def test_straight_windows_have_no_say_however_many_they_are():
    straight = evidence(window(turn(N, yaw_rad=0.0), theta_of(), noise_px=0.1))
    turning = evidence(window(turn(N), theta_of(), noise_px=0.1))
    many = [straight] * 400
    assert sigma(*many)[FOCALS[0]] > 0.1
    assert sigma(*many, turning)[FOCALS[0]] < 1.2 * sigma(turning)[FOCALS[0]]


def test_a_bend_of_the_picture_limits_what_a_slight_turn_shows_of_the_focal(monkeypatch):
    T_s_p = turn(N, yaw_rad=0.002)
    made = window(T_s_p, theta_of(), n_points=500, noise_px=0.01)
    f = layout.cameras(made.truth.theta, made.m.size)[0].fx
    turned = np.linalg.norm(np.ptp(se3.so3_log(T_s_p[:, :3, :3])[:, :2], axis=0))
    limit = module.BIAS_PX / (turned * f)
    assert 0.01 < limit < 0.2
    assert (sigma(evidence(made))[FOCALS] > limit).all()
    monkeypatch.setattr(module, "BIAS_PX", 1e-9)
    monkeypatch.setattr(module, "COMMON", 0.0)
    assert (sigma(evidence(made))[FOCALS] < limit).all()
