from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.bundle import moving, problem, solution, window
from calm_edge.backbones.bundle.initialise import triangulated
from calm_edge.backbones.bundle.solver import Solution, solve, whitened_lengths
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Hints, KitBelief
from tests.backbones.bundle.board import pasted
from tests.backbones.bundle.exact_window import SIZE, theta_of, turn
from tests.backbones.bundle.exact_window import window as exact_window
from tests.synthetic.drive import exposed, make_rig
from tests.synthetic.render import render_views
from tests.synthetic.settings import Settings
from tests.synthetic.shots import T_primary_assistant
from tests.synthetic.world import make_world

N = 8
# spacings a second: oncoming at our speed, ahead at our speed, crossing
VELOCITIES = {"oncoming": [0, 0, -10], "ahead": [0, 0, 10], "crossing": [6, 0, 0]}


def window_with(velocity, *, count=12, reach=(8, 25), noise_px=0.15, readout_s=0.0, seed=0):
    """A window with `count` more points, which move; the state; whether each point (M,) moves.

    reach: distances ahead of the primary in the middle of the window.
    """
    theta = theta_of()
    theta[layout.READOUT] = readout_s
    made = exact_window(turn(N), theta, noise_px=noise_px, n_points=200, seed=seed)
    m, truth, rng = made.m, made.truth, np.random.default_rng(seed)
    away = np.exp(rng.uniform(*np.log(reach), count))
    aside = np.c_[rng.uniform(-0.2, 0.2, count), rng.uniform(-0.1, 0.1, count), np.ones(count)]
    T_s_mid = np.linalg.inv(truth.T_c_s[N // 2])
    X = (aside * away[:, None]) @ T_s_mid[:3, :3].T + T_s_mid[:3, 3]
    t_mid, n_still = m.t[N // 2], len(truth.points)
    view, point = (index.ravel() for index in np.indices((2 * N, count)))
    every = problem.Measurements(
        view, point, np.full((len(view), 2), 100.0), np.full(len(view), 0.5), m.eye, m.t, SIZE
    )
    eye = m.eye[view]
    for _ in range(3):  # the instant depends on the row
        late = readout_s * (every.uv[:, 1] / (SIZE[eye, 1] - 1) - 0.5)
        when = m.t[view] - t_mid + late
        there = np.c_[X[point] + np.array(velocity) * when[:, None], np.ones(len(view))]
        there /= np.linalg.norm(there, axis=1, keepdims=True)
        own = problem.State(truth.T_c_s, there, theta)
        uv, z = problem.project(own, replace(every, point=np.arange(len(view))))
        every = replace(every, uv=uv)
    seen = (z > 3 * there[:, 3]) & (uv > 0).all(1) & (uv < SIZE[eye] - 1).all(1)
    every = every.at(np.flatnonzero(seen))
    uv = every.uv + noise_px * rng.standard_normal(every.uv.shape)
    order = np.argsort(np.concatenate([m.view, every.view]), kind="stable")
    point = np.concatenate([m.point, n_still + every.point])[order]
    kept, point = np.unique(point, return_inverse=True)
    joined = replace(
        m, view=np.concatenate([m.view, every.view])[order], point=point,
        uv=np.concatenate([m.uv, uv])[order], sigma_px=np.full(len(order), 0.5),
    )  # fmt: skip
    middle = np.c_[X, np.ones(count)]
    points = np.concatenate([truth.points, middle / np.linalg.norm(middle, axis=1)[:, None]])
    state = replace(truth, points=points[kept])
    return joined, state, kept >= n_still


def unsolved(m, state):
    """The state as a solution."""
    return Solution(state, 0.0, whitened_lengths(state, m))


@pytest.mark.parametrize("velocity", VELOCITIES.values(), ids=VELOCITIES)
@pytest.mark.parametrize("readout_s", [0.0, 0.03])
def test_points_that_move_are_found_and_no_others(velocity, readout_s):
    m, state, moves = window_with(velocity, readout_s=readout_s)
    found = moving.moving(unsolved(m, state), m)
    assert moves.sum() >= 10
    assert found[moves].mean() > 0.8
    assert not found[~moves].any()


def test_one_eye_cannot_tell():
    m, state, moves = window_with(VELOCITIES["oncoming"])
    m = m.at(np.flatnonzero((m.eye[m.view] == 0) | ~moves[m.point]))
    assert not moving.moving(unsolved(m, state), m).any()


def test_points_beyond_the_reach_of_the_eyes_are_undecided():
    m, state, moves = window_with(VELOCITIES["crossing"], reach=(300, 500))
    unmoved = unsolved(m, state)
    assert np.median(unmoved.residual[moves[m.point]]) > 3
    assert not moving.moving(unmoved, m).any()


def test_wrong_matches_are_not_a_motion():
    m, state, _ = window_with([0, 0, 0])
    uv, rng = m.uv.copy(), np.random.default_rng(3)
    wrong = rng.random(len(uv)) < 0.08
    uv[wrong] += rng.uniform(-30, 30, (int(wrong.sum()), 2))
    m = replace(m, uv=uv)
    assert moving.moving(unsolved(m, state), m).mean() < 0.01


def test_a_motion_is_found_from_wherever_the_solution_has_its_point():
    m, state, moves = window_with(VELOCITIES["ahead"])
    state.points[moves] = [0.0, 0.0, -0.1, 0.99]
    found = moving.moving(unsolved(m, state), m)
    assert found[moves].mean() > 0.8 and not found[~moves].any()


def test_a_window_is_solved_better_without_what_moves():
    """A queue ahead that drives as fast as the car itself."""
    m, state, moves = window_with(VELOCITIES["ahead"], count=60)
    ties, prior = problem.rig_ties(m), layout.prior((76.0, 66.0))
    solved = solve(state, m, ties, prior, robust_scale=0.5)
    found = moving.moving(solved, m)
    assert found[moves].mean() > 0.8 and found[~moves].mean() < 0.01
    kept, left = moving.without_moving(solved, m)
    assert len(kept.state.points) == (~found).sum() == left.point.max() + 1
    assert np.allclose(kept.residual, whitened_lengths(kept.state, left))
    again = solve(kept.state, left, ties, prior, robust_scale=0.5)
    off = [
        np.linalg.norm((each.state.T_c_s - state.T_c_s)[:, :3, 3], axis=1).max()
        for each in (solved, again)
    ]
    assert off[1] < off[0]


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_a_wrong_length_of_the_path_is_not_a_motion_of_the_points(factor):
    """Hardly any of the points that stand still is lost in a window of a wrong scale."""
    m, state, _ = window_with([0, 0, 0], count=40)
    T_c_s = state.T_c_s.copy()
    T_a_p = T_c_s[N:] @ np.linalg.inv(T_c_s[:N])
    T_c_s[:N, :3, 3] *= factor
    T_c_s[N:] = T_a_p @ T_c_s[:N]
    wrong = unsolved(m, replace(state, T_c_s=T_c_s))
    assert np.median(wrong.residual) > 2
    assert moving.moving(wrong, m).mean() < 0.02


@pytest.fixture(scope="module")
def behind_a_van():
    """Six pictures of each eye, 0.3 s apart, behind a van at our speed; its pixels; the truth."""
    settings = Settings(frames=18, width=320, height=128, density=14.0, start_s=1.0)
    world, n = make_world(settings.seed, settings.density), 6
    rig, rng = make_rig(world, settings), np.random.default_rng(0)
    images, cameras, poses = [], [], []
    for eye in (0, 1):
        poses.append(rig.T_w_c[eye][::3])
        views, _ = render_views(world.scene, poses[-1], rig.cameras[eye], oversample=1)
        images += [exposed(view, 0.0, rng, settings) for view in views]
        cameras += [rig.cameras[eye]] * n
    T_w_c, t = np.concatenate(poses), np.concatenate([rig.times[eye][::3] for eye in (0, 1)])
    T_w_van = np.tile(poses[0][0], (2 * n, 1, 1))
    speed = np.linalg.norm(poses[0][-1][:3, 3] - poses[0][0][:3, 3]) / (t[n - 1] - t[0])
    away = np.stack([np.full(2 * n, -0.8), np.full(2 * n, 0.1), 9.0 + speed * (t - t[0])], -1)
    T_w_van[:, :3, 3] = se3.transform(poses[0][0], away)
    images, van = pasted(images, cameras, T_w_c, T_w_van, (2.4, 1.9))
    stamps = ORIGIN_NS + np.round(t * 1e9).astype(np.int64)
    sizes = np.array([[settings.width, settings.height]] * 2)
    theta = theta_of(settings.hfov_deg)
    theta[layout.RIG] = layout.rig_vector(T_primary_assistant(settings))
    belief = KitBelief(
        theta, layout.prior(settings.hfov_deg).information + 1e6 * np.eye(len(theta))
    )
    hints = Hints(np.repeat([0, 1], n), stamps, sizes=sizes, kit=belief)
    T_s_c = se3.inverse(T_w_c[0]) @ T_w_c
    T_s_c[:, :3, 3] /= settings.spacing_m
    return images, hints, van, T_s_c


def test_a_van_is_no_landmark_and_what_stands_still_remains(behind_a_van):
    images, hints, van, T_s_c = behind_a_van
    theta = hints.kit.mean
    m = window.with_enough_views(window.measure(images, hints, [theta], rig_known=True))
    T_c_s = se3.inverse(T_s_c)
    start = problem.State(T_c_s, triangulated(m, T_c_s, theta), theta)
    solved = solution.solved(start, m, problem.rig_ties(m), hints.kit, hints, hints.kit, 1.0)

    def kinds(marks, index):
        """Number of points on the van alone, and of those beside it."""
        column, row = np.round(marks.uv).astype(int).T
        count = np.bincount(index)
        share = np.bincount(index, van[marks.view, row, column]) / np.maximum(count, 1)
        return ((share == 1) & (count >= moving.LEAST_SEEN)).sum(), (share == 0).sum()

    marks = solved.landmarks
    (on_van, beside), (left, remain) = kinds(m, m.point), kinds(marks, marks.index)
    assert on_van >= 8 and left <= 0.2 * on_van
    assert beside > 80 and remain > 0.97 * beside
    p, p_true = solved.T_s_c[:6, :3, 3], T_s_c[:6, :3, 3]
    length = np.linalg.norm(np.diff(p_true, axis=0), axis=1).sum()
    assert np.linalg.norm(p - p_true, axis=1).max() < 0.02 * length
