import numpy as np
import pytest

from bench import window_errors
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.types import LocalizerUpdate, Metre, Prediction, Submap, Trajectory

N = 11
SPACING = 0.5
T_NS = 10**9 + 100_000_000 * np.arange(N)


def poses(step_m=1.0):
    """Forward with a turn."""
    step = se3.exp(np.array([[0, 0, step_m, 0, 0.02, 0]]))[0]
    T = [np.eye(4)]
    for _ in range(N - 1):
        T.append(T[-1] @ step)
    return np.array(T)


def update(T, scale_sigma=0.02, covariance=None):
    """An update whose raw unit is the spacing."""
    raw = T.copy()
    raw[:, :3, 3] /= SPACING
    ids = tuple(range(N))
    submap = Submap(
        0, ids, (), 0, T_NS, raw, (), T, (), SPACING, np.eye(4), np.zeros(2),
        scale_log_sigma=scale_sigma,
    )  # fmt: skip
    prediction = Prediction((), raw, covariance=covariance)
    return LocalizerUpdate(submap, prediction, Trajectory(np.arange(N), T_NS, T, np.eye(4), 0))


def errors(updates, truth, metre=0.03):
    submaps = [u.submap for u in updates]
    return window_errors.drive_errors(updates, submaps, Metre(metre), truth, SPACING)


def test_a_window_that_is_too_long_by_its_sigma():
    T = poses()
    long = T.copy()
    long[:, :3, 3] *= np.exp(0.02)
    found = errors([update(long)], Truth(T_NS, T))
    assert found.first == pytest.approx(np.array([[0.02, 0.02]]), abs=1e-6)
    assert found.whole == pytest.approx((0.02, 0.03), abs=1e-6)
    rows = window_errors.table([found])
    assert [row.rms for row in rows[:3]] == pytest.approx([1.0, 1.0, 2 / 3], abs=1e-4)
    # no covariance of the poses: not reported
    assert rows[3].rms is None and rows[3].missing == 3


def test_a_standing_window_has_no_error_of_scale():
    T = poses(0.01)
    found = errors([update(T)], Truth(T_NS, T))
    assert found.first.shape == found.last.shape == (0, 2) and np.isnan(found.whole[0])


def test_motions_over_a_second_have_the_errors_that_their_covariance_says():
    rng, sigma, ratios = np.random.default_rng(2), 0.01, []
    true, errors_of = poses(), []
    covariance = (np.eye(6 * N) * sigma**2).astype(np.float32)
    for _ in range(200):
        noise = sigma * rng.standard_normal((N, 6))
        noise[:, :3] *= SPACING
        one = window_errors.motions(
            (held := update(true @ se3.exp(noise), covariance=covariance)).submap,
            held.prediction,
            Truth(T_NS, true),
        )
        assert one.error.shape == (1, 6)
        errors_of.append(one.error[0])
        ratios.append(one.error[0] / one.sigma[0])
    assert np.sqrt(np.square(ratios).mean(0)) == pytest.approx(np.ones(6), rel=0.2)
    # the rotation of the start, times the way, is an error of the end
    assert np.std(np.array(errors_of)[:, 0]) > 5 * sigma * SPACING
