from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import path_length, posterior, solution, solver, window
from calm_edge.backbones.bundle.path_length import LengthPrior
from calm_edge.backbones.bundle.problem import State, tie_residuals
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Hints, KitBelief, PathLength
from tests.backbones.bundle.exact_window import theta_of, turn
from tests.backbones.bundle.exact_window import window as exact

N, SHARED = 8, np.arange(3)
CERTAIN = 0.03


def length(state, views=SHARED):
    centres = se3.inverse(state.T_c_s[views])[:, :3, 3]
    return np.linalg.norm(np.diff(centres, axis=0), axis=1).sum()


def kit(theta):
    """A belief that is sure of the kit."""
    return KitBelief(theta, np.diag(np.full(layout.SIZE, 1e-3) ** -2.0))


def far_window():
    """Far points; those of one region of the assistant's picture share an error of 1 px."""
    made = exact(turn(N, 0.02), theta_of(), n_points=600, delay_s=0.0, noise_px=0.1)
    m, far = made.m, made.truth.points[:, 3] < 1 / 150
    rows = far[made.m.point]
    kept, point = np.unique(m.point[rows], return_inverse=True)
    m = replace(m, view=m.view[rows], point=point, uv=m.uv[rows].copy(), sigma_px=m.sigma_px[rows])
    offset = np.random.default_rng(2).normal(0, 1, 8)
    assistant = m.eye[m.view] == 1
    m.uv[assistant, 0] += offset[(m.uv[assistant, 0] // 64).astype(int) % 8]
    return m, State(made.truth.T_c_s, made.truth.points[kept], made.truth.theta), made.ties


def hinted(m, *lengths):
    """Hints of a window beside others, which say (views, length, sigma of its log)."""
    said = tuple(PathLength(views, length, sigma) for views, length, sigma in lengths)
    return Hints(eyes=m.eye, t_ns=np.r_[np.arange(N), np.arange(N)], lengths=said)


def solved(*sigmas, factor=1.0):
    """Solve beside windows of these sigmas whose lengths are true, times `factor`."""
    m, truth, ties = far_window()
    ends = SHARED, N - 1 - SHARED[::-1]
    hints = hinted(
        m,
        *(
            (views, factor * length(truth, views), sigma)
            for views, sigma in zip(ends, sigmas, strict=False)
        ),
    )
    belief = kit(truth.theta)
    found = solution.solved(truth, m, ties, belief, hints, belief, 1.0)
    after = State(se3.inverse(found.T_s_c), truth.points, truth.theta)
    return found, [np.log(length(after, views) / length(truth, views)) for views in ends]


def test_the_lengths_of_surer_windows_replace_one_that_is_noise():
    alone, errors = solved()
    assert np.abs(errors).min() > 3 * CERTAIN and alone.scale_log_sigma > 2 * CERTAIN
    for sigmas in ((CERTAIN,), (CERTAIN, CERTAIN)):
        held, errors = solved(*sigmas)
        assert np.abs(errors).max() < CERTAIN
        assert CERTAIN / 2 < held.scale_log_sigma < 2 * CERTAIN


def test_a_window_keeps_its_own_length_beside_no_surer_ones_and_wrong_ones():
    alone, _ = solved()
    for other, _ in (solved(alone.scale_log_sigma), solved(CERTAIN, factor=2.0)):
        assert np.array_equal(alone.T_s_c, other.T_s_c)


def test_a_window_of_far_points_alone_is_never_the_right_one(monkeypatch):
    alone, _ = solved()
    monkeypatch.setattr(path_length, "POOR", alone.scale_log_sigma / 2)
    _, errors = solved(CERTAIN, factor=2.0)
    assert errors[0] == pytest.approx(np.log(2.0), abs=CERTAIN)


def test_the_derivative_is_that_of_the_log_of_the_length():
    _, truth, _ = far_window()
    prior = LengthPrior(SHARED, length(truth), 0.1, 4.0)
    assert prior.cost(truth) == pytest.approx(0)
    J, step = prior.jacobian(truth), 1e-6
    for column in range(6 * len(SHARED)):
        twist = np.zeros((len(truth.T_c_s), 6))
        twist.ravel()[column] = step
        moved = replace(truth, T_c_s=se3.exp(twist) @ truth.T_c_s)
        change = np.log(length(moved) / length(truth)) / step
        assert J[column] == pytest.approx(change, abs=1e-5)
    assert not J[6 * len(SHARED) :].any()


def test_rescaling_keeps_the_rig_and_the_pictures_of_the_primary():
    m, truth, ties = far_window()
    other = path_length.rescaled(truth, m, LengthPrior(SHARED, 1.7 * length(truth), 0.1, 1.0))
    assert length(other) == pytest.approx(1.7 * length(truth))
    T = other.T_c_s
    off = tie_residuals(
        T[ties.before], T[ties.after], T[ties.assistant], layout.rig(truth.theta), 0.0, ties
    )
    assert np.abs(off).max() < 1e-6
    primary = m.eye[m.view] == 0
    before, after = (window.project(state, m)[0][primary] for state in (truth, other))
    assert np.abs(before - after).max() < 1e-6


def test_a_measurement_beside_the_pictures_joins_the_posterior():
    m, truth, ties = far_window()
    prior = kit(truth.theta)
    found = solver.solve(truth, m, ties, prior, robust_scale=0.5)
    known = posterior.posterior(found, m, ties, prior, 0.5, 1.0)
    hints = hinted(m, (SHARED, length(truth), CERTAIN))
    (held,) = path_length.length_priors(hints, m, found.state, known)
    J = held.jacobian(found.state)
    joined = known.joined(J, held.information, CERTAIN)
    column = np.r_[J, np.zeros(layout.SIZE)][6:]
    A = np.linalg.inv(known.inverse[6:, 6:]) + held.information * np.outer(column, column)
    assert np.allclose(np.linalg.inv(A), joined.inverse[6:, 6:], rtol=1e-6, atol=1e-9)
    own = min(known.length_log_sigma(found.state, SHARED), path_length.OWN_UNKNOWN)
    both = (own**-2 + CERTAIN**-2) ** -0.5
    assert joined.length_log_sigma(found.state, SHARED) == pytest.approx(both, rel=0.2)
