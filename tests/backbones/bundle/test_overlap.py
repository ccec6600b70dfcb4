"""Windows tied by their common keyframes: nothing counts twice, and a wrong one does not spread."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import overlap, solution
from calm_edge.backbones.bundle.normal_equations import fix_spacing
from calm_edge.backbones.bundle.problem import State
from calm_edge.backbones.bundle.solver import solve
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.types import Hints, KitBelief
from tests.backbones.bundle.exact_window import part, perturbed, theta_of, turn, window

N, SHARED = 6, 3
WINDOWS, DRIVES = 5, 20
# wide enough to weigh all pixels alike: their noise is Gaussian here
WIDE = 50.0
KIT_SIGMA = layout._vector(0.02, 1e-3, 3e-4, 7e-3, 0.03, 2e-3, 1e-3, 1e-3)


def hints_of(w, before=None, n_overlap=SHARED):
    t_ns = np.round(w.m.t * 1e9).astype(np.int64)
    return Hints(w.m.eye, t_ns, n_overlap=n_overlap, overlap=before, n_shared=SHARED)


def marginal_of(w, state, prior=None):
    weight = np.ones(len(w.m.view))
    t_ns = hints_of(w).t_ns
    normal = measured(w, state)
    return overlap.marginal(normal, state, w.m, w.ties, weight, prior, t_ns, SHARED, 1.0)


def measured(w, state):
    return overlap.measured(state, w.m, w.ties, np.ones(len(w.m.view)))


def covariance(w, state, belief, prior):
    """Of the primary poses but the first."""
    H = measured(w, state).H
    H[-layout.SIZE :, -layout.SIZE :] += belief.information
    fix_spacing(H, state.theta, layout.SPACING_SIGMA)
    if prior is not None:
        prior.add_to(H, np.zeros(len(H)), state)
    return np.linalg.inv(H[6:, 6:])[: 6 * N - 6, : 6 * N - 6]


def path(state):
    """Log length of the primary's path, and its derivative by left twists of poses 1 to N - 1."""
    T_s_c = se3.inverse(state.T_c_s[:N])
    step = np.diff(T_s_c[:, :3, 3], axis=0)
    length = np.linalg.norm(step, axis=1)
    by_centre = np.zeros((N, 3))
    by_centre[1:] += step / length[:, None]
    by_centre[:-1] -= step / length[:, None]
    by_twist = np.zeros((N, 6))
    by_twist[:, :3] = -np.einsum("ni,nij->nj", by_centre, T_s_c[:, :3, :3])
    return np.log(length.sum()), by_twist[1:].reshape(-1) / length.sum()


def exact_evidence(w, state):
    """Of one window on the kit, poses marginalised out, for independent errors of the pixels."""
    normal = measured(w, state)
    H, g = normal.H.copy(), normal.g
    fix_spacing(H, state.theta, layout.EVIDENCE_SPACING_SIGMA)
    kit, poses = slice(len(g) - layout.SIZE, None), slice(6, len(g) - layout.SIZE)
    by_pose = np.linalg.solve(H[poses, poses], np.c_[H[poses, kit], g[poses]])
    information = H[kit, kit] - H[kit, poses] @ by_pose[:, :-1]
    gradient = g[kit] - H[kit, poses] @ by_pose[:, -1]
    return KitBelief(state.theta - np.linalg.pinv(information) @ gradient, information)


@dataclass
class Errors:
    """Of one window: chi-square of its poses and of its overlap by degree of freedom; log scale
    error and its sigma; mismatch."""

    poses: float
    ahead: float
    scale: float
    scale_sigma: float
    mismatch: float


def handed_on(o, truth):
    """Chi-square by degree of freedom of an overlap at the true poses and kit."""
    T = truth.T_c_s[N - SHARED : N]
    off = se3.log(T[1:] @ se3.inverse(T[0]) @ o.T_first_k[1:]).reshape(-1)
    e = off - o.offset - o.by_kit @ (truth.theta - o.kit)
    return e @ o.information @ e / len(e)


def drive(seed):
    """Errors of consecutive windows of one path, the kit drawn from its prior and learned."""
    rng = np.random.default_rng(seed)
    mean = theta_of()
    theta = mean + KIT_SIGMA * rng.standard_normal(layout.SIZE)
    theta[layout.RIG_CENTRE] /= np.linalg.norm(theta[layout.RIG_CENTRE])
    total = N + (WINDOWS - 1) * (N - SHARED)
    made = window(turn(total, 0.02), theta, n_points=12 * total, noise_px=0.5, seed=seed)
    beliefs, before = [KitBelief(mean, np.diag(KIT_SIGMA**-2))], None
    for k in range(WINDOWS):
        w = part(made, k * (N - SHARED), N)
        prior = overlap.prior(hints_of(w, before), 1.0)
        belief = product(beliefs)
        belief.mean[layout.RIG_CENTRE] /= np.linalg.norm(belief.mean[layout.RIG_CENTRE])
        start = replace(w.truth, theta=belief.mean.copy())
        found = solve(start, w.m, w.ties, belief, robust_scale=WIDE)
        off = 0.0
        if prior is not None:
            alone = found.state
            off = overlap.mismatch(prior, measured(w, alone), alone, belief.information)
            found = solve(alone, w.m, w.ties, belief, pose_priors=(prior,), robust_scale=WIDE)
        before = marginal_of(w, found.state, prior)
        beliefs.append(exact_evidence(w, found.state))
        C = covariance(w, found.state, belief, prior)
        e = se3.log(found.state.T_c_s[1:N] @ se3.inverse(w.truth.T_c_s[1:N])).reshape(-1)
        length, by_pose = path(found.state)
        yield Errors(
            e @ np.linalg.solve(C, e) / len(e),
            handed_on(before, w.truth),
            length - path(w.truth)[0],
            np.sqrt(by_pose @ C @ by_pose),
            off,
        )


@pytest.fixture(scope="module")
def tied():
    return [list(drive(seed)) for seed in range(DRIVES)]


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_errors_of_a_hundred_tied_windows_are_as_large_as_claimed(tied):
    every = [e for one in tied for e in one]
    assert 0.9 < np.sqrt(np.mean([e.poses for e in every])) < 1.1
    assert 0.7 < rms([e.scale / e.scale_sigma for e in every]) < 1.3
    # and do not grow along the chain
    for k in range(WINDOWS):
        assert 0.8 < np.sqrt(np.mean([one[k].poses for one in tied])) < 1.2
        assert 0.8 < np.sqrt(np.mean([one[k].ahead for one in tied])) < 1.2
        if k:
            assert 0.6 < np.mean([one[k].mismatch for one in tied]) < 1.4
    assert max(e.mismatch for e in every) < solution.MAX_MISMATCH


@pytest.fixture(scope="module")
def pair():
    """Two windows that share keyframes, and the overlap that the first hands on."""
    made = window(turn(2 * N - SHARED), theta_of(), n_points=200, noise_px=0.5)
    first, second = part(made, 0, N), part(made, N - SHARED, N)
    return first, second, marginal_of(first, first.truth)


def test_what_the_next_window_measures_again_is_not_handed_on():
    made = window(turn(N), theta_of(), n_points=200)
    # all points but those of the shared keyframes are unseen elsewhere
    shared = np.isin(made.m.view % N, np.arange(N - SHARED, N))
    m = replace(
        made.m, view=made.m.view[shared], point=made.m.point[shared],
        uv=made.m.uv[shared], sigma_px=made.m.sigma_px[shared],
    )  # fmt: skip
    alone = marginal_of(replace(made, m=m), made.truth)
    full = marginal_of(made, made.truth)
    assert np.trace(alone.information) < 1e-3 * np.trace(full.information)
    assert np.linalg.eigvalsh(full.information).min() > 0


def test_both_windows_together_claim_hardly_more_than_all_measurements_at_once(pair):
    _, second, handed = pair
    made = window(turn(2 * N - SHARED), theta_of(), n_points=200, noise_px=0.5)
    kit = KitBelief(made.truth.theta, 1e12 * np.eye(layout.SIZE))

    def of_shared(w, views, prior=None):
        H = measured(w, w.truth).H
        H[-layout.SIZE :, -layout.SIZE :] += kit.information
        if prior is not None:
            prior.add_to(H, np.zeros(len(H)), w.truth)
        held = np.delete(np.arange(len(H)), 6 * views[0] + np.arange(6))
        rows = np.searchsorted(held, (6 * views[1:, None] + np.arange(6)).reshape(-1))
        return np.linalg.inv(H[np.ix_(held, held)])[np.ix_(rows, rows)]

    at_once = of_shared(made, np.arange(N - SHARED, N))
    tied = of_shared(second, np.arange(SHARED), overlap.prior(hints_of(second, handed), 1.0))
    alone = of_shared(second, np.arange(SHARED))
    # both place the points by the pixels of the shared keyframes, which count twice in so far
    claimed = np.sqrt(np.diag(tied))
    assert (claimed > 0.94 * np.sqrt(np.diag(at_once))).all()
    assert (claimed < np.sqrt(np.diag(alone))).all()


def test_the_prior_is_differentiated_right(pair):
    _, second, handed = pair
    prior, state = overlap.prior(hints_of(second, handed), 1.0), perturbed(second.truth)
    J, step = prior.jacobian(state), 1e-6
    for column in range(J.shape[1]):
        moved = []
        for sign in (1, -1):
            d = np.zeros(J.shape[1])
            d[column] = sign * step
            poses = se3.exp(d[: -layout.SIZE].reshape(-1, 6)) @ state.T_c_s
            moved.append(
                prior.residual(State(poses, state.points, state.theta + d[-layout.SIZE :]))
            )
        assert J[:, column] == pytest.approx((moved[0] - moved[1]) / (2 * step), abs=1e-6)


def test_another_kit_moves_what_is_handed_on():
    made = window(turn(N), theta_of(), n_points=200)
    wrong = made.truth.theta.copy()
    wrong[layout.LOG_FOCAL] += 0.03
    belief = KitBelief(wrong, 1e8 * np.eye(layout.SIZE))
    start = replace(made.truth, theta=wrong)
    solved = solve(start, made.m, made.ties, belief, robust_scale=WIDE).state
    o = marginal_of(made, solved)
    T = made.truth.T_c_s[N - SHARED : N]
    off = se3.log(T[1:] @ se3.inverse(T[0]) @ o.T_first_k[1:]).reshape(-1)
    left = off - o.by_kit @ (made.truth.theta - o.kit)
    assert np.linalg.norm(left[:3]) < 0.2 * np.linalg.norm(off[:3])


@pytest.mark.parametrize("factor", [0.22, 0.7, 1.4])
def test_a_wrong_window_does_not_reach_the_next(pair, factor):
    first, second, _ = pair
    belief = KitBelief(theta_of(), np.diag(KIT_SIGMA**-2))

    def solved_with(w, before=None):
        hints = replace(hints_of(w, before), sizes=w.m.size)
        return solution.solved(w.truth, w.m, w.ties, belief, hints, belief, solution.FREE)

    handed = solved_with(first).overlap
    T = handed.T_first_k.copy()
    T[:, :3, 3] *= factor
    wrong = replace(handed, T_first_k=T)
    solved = [solved_with(second, before) for before in (wrong, handed, None)]
    assert solved[0].overlap_mismatch > solution.MAX_MISMATCH > solved[1].overlap_mismatch
    assert solved[0].notices == (solution.CONTRADICTED,) and not solved[1].notices
    assert np.array_equal(solved[0].T_s_c, solved[2].T_s_c)
    assert np.array_equal(solved[0].overlap.information, solved[2].overlap.information)
    assert not np.array_equal(solved[1].T_s_c, solved[2].T_s_c)


def test_how_far_the_poses_were_drawn_is_told(pair):
    first, second, _ = pair
    belief = KitBelief(theta_of(), np.diag(KIT_SIGMA**-2))
    earlier = solve(
        first.truth, first.m, first.ties, belief, robust_scale=WIDE, tolerance=1e-9
    ).state
    prior = overlap.prior(hints_of(second, marginal_of(first, earlier)), 1.0)
    alone = solve(
        second.truth, second.m, second.ties, belief, robust_scale=WIDE, tolerance=1e-9
    ).state
    tied = solve(
        alone,
        second.m,
        second.ties,
        belief,
        pose_priors=(prior,),
        robust_scale=WIDE,
        tolerance=1e-9,
    ).state
    found = overlap.drawn(prior, measured(second, tied), tied, belief.information)
    for k in range(2):
        size = [
            np.linalg.norm(prior.difference(state).reshape(-1, 2, 3)[:, k])
            for state in (tied, alone)
        ]
        assert abs(size[0] / size[1] - 1) > 0.05
        assert found[k] == pytest.approx(size[0] / size[1], rel=0.02)


def test_an_overlap_counts_only_for_the_keyframes_it_is_of(pair):
    _, second, handed = pair
    assert overlap.prior(hints_of(second, handed), 1.0) is not None
    assert overlap.prior(hints_of(second, None), 1.0) is None
    # a window that begins with more of the earlier ones measures these again
    assert overlap.prior(hints_of(second, handed, SHARED + 1), 1.0) is None
    other = replace(handed, t_ns=handed.t_ns + 1)
    assert overlap.prior(hints_of(second, other), 1.0) is None


def test_a_window_of_nothing_but_shared_keyframes_hands_nothing_on(pair):
    first = pair[0]
    t_ns = hints_of(first).t_ns
    weight = np.ones(len(first.m.view))
    for n in (0, 1, N):
        normal = measured(first, first.truth)
        found = overlap.marginal(
            normal, first.truth, first.m, first.ties, weight, None, t_ns, n, 1.0
        )
        assert found is None
