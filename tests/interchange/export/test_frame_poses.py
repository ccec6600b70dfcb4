"""Poses of frames between keyframes."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.interchange.export.frame_poses import (
    FramePoses,
    LivePoses,
    PoseSource,
    of_assistant,
    of_primary,
)
from tests.interchange.export.drives import (
    EVERY,
    FRAMES,
    LATE_NS,
    T_P_A,
    assistant_poses,
    live_poses,
    true_poses,
    true_times,
)

KEYFRAMES = slice(None, None, EVERY)
NO_LIVE = LivePoses(
    np.zeros(0, np.int64), np.zeros((0, 4, 4)), np.zeros(0, np.int64), np.zeros((0, 3, 3))
)


def certain(n: int) -> np.ndarray:
    """Covariances (n, 3, 3) of nearly exact positions."""
    return np.tile(1e-12 * np.eye(3), (n, 1, 1))


def live(scale: float = 0.8, epoch: int | None = None) -> LivePoses:
    """Live poses, with an epoch that grows from frame `epoch` on."""
    samples = [s for s in live_poses(scale) if np.isfinite(s.T_w_c).all()]
    t = np.array([s.t_ns for s in samples])
    later = t >= true_times()[epoch] if epoch is not None else np.zeros(len(t), bool)
    return LivePoses(
        t, np.array([s.T_w_c for s in samples]), later.astype(np.int64), certain(len(t))
    )


def at(poses: LivePoses) -> FramePoses:
    return of_primary(true_times(), true_times()[KEYFRAMES], true_poses()[KEYFRAMES], poses, 0.5)


def error(poses: FramePoses, chosen: np.ndarray) -> float:
    return float(np.linalg.norm((poses.T_w_c - true_poses())[chosen, :3, 3], axis=1).max())


def test_frames_follow_the_tracker_tied_to_both_keyframes() -> None:
    poses = at(live())
    expected = ["keyframe" if i % EVERY == 0 else "tracked" for i in range(FRAMES)]
    # between the first two keyframes and about frame 16 the tracker was lost
    for i in (1, 2, 3, 13, 14, 15, 17, 18, 19):
        expected[i] = "interpolated"
    assert poses.source.tolist() == expected
    # the tracker's scale is 20 % off and it drifts 1 cm a frame: tied to keyframes it is not
    inner = (poses.source == PoseSource.TRACKED) & (np.arange(FRAMES) < FRAMES - 3)
    assert error(poses, inner) < 0.03
    assert np.array_equal(poses.T_w_c[KEYFRAMES], true_poses()[KEYFRAMES])


def test_the_tracker_sees_what_interpolation_misses() -> None:
    T = true_poses()
    T[6, :3, 3] += [0.3, 0, 0]  # a bump between two keyframes
    t, key = true_times(), true_poses()[KEYFRAMES]
    exact = LivePoses(t, T, np.zeros(FRAMES, np.int64), certain(FRAMES))
    tied = of_primary(t, t[KEYFRAMES], key, exact, 0.5).T_w_c[6]
    between = of_primary(t, t[KEYFRAMES], key, NO_LIVE, 0.5).T_w_c[6]
    assert np.linalg.norm((tied - T[6])[:3, 3]) < 1e-9
    assert np.linalg.norm((between - T[6])[:3, 3]) > 0.25


def test_a_noisy_position_is_weighted_with_the_interpolated_one() -> None:
    rng = np.random.default_rng(2)
    t, T, key = true_times(), true_poses(), true_poses()[KEYFRAMES]
    noisy = T.copy()
    noise = rng.normal(0, 0.3, (FRAMES, 3)) * [0.01, 0.01, 1]
    noisy[:, :3, 3] += (T[:, :3, :3] @ noise[..., None])[..., 0]
    errors = []
    inner = (np.arange(FRAMES) % EVERY > 0) & (np.arange(FRAMES) < FRAMES - 3)
    for sigma in ([0.003, 0.003, 0.3], [np.nan] * 3):
        covariance = np.tile(np.diag(np.square(sigma)), (FRAMES, 1, 1))
        live_poses = LivePoses(t, noisy, np.zeros(FRAMES, np.int64), covariance)
        poses = of_primary(t, t[KEYFRAMES], key, live_poses, 0.5)
        assert set(poses.source[inner].tolist()) <= {"tracked", "interpolated"}
        errors.append(error(poses, inner))
    # an unknown covariance leaves the tracker alone
    assert errors[0] < 0.1 < 0.2 < errors[1]


def test_a_new_epoch_or_a_wrong_tracker_is_not_used() -> None:
    jumped = at(live(epoch=10))
    assert set(jumped.source[9:12].tolist()) == {"interpolated"}
    assert set(jumped.source[5:8].tolist()) == {"tracked"}
    wrong = at(live(scale=0.3))
    assert "tracked" not in wrong.source[:-3].tolist()


def test_after_the_last_keyframe_only_the_tracker_gives_poses() -> None:
    tail = slice(FRAMES - 3, None)
    poses = at(live(scale=1.0))
    assert set(poses.source[tail].tolist()) == {"tracked"}
    assert error(poses, np.arange(FRAMES) >= FRAMES - 3) < 0.1
    alone = at(NO_LIVE)
    assert set(alone.source[tail].tolist()) == {"none"} and np.isnan(alone.T_w_c[tail]).all()


@pytest.mark.parametrize(("stands", "source"), [(True, "interpolated"), (False, "none")])
def test_a_long_gap_is_interpolated_only_while_the_car_stands(stands: bool, source: str) -> None:
    t = np.array([0, 5_000_000_000, 10_000_000_000])
    T = np.tile(np.eye(4), (2, 1, 1))
    T[1, 2, 3] = 0.02 if stands else 30.0
    assert of_primary(t, t[[0, 2]], T, NO_LIVE, 0.5).source.tolist() == [
        "keyframe",
        source,
        "keyframe",
    ]


def test_the_assistant_is_placed_by_the_rig_at_its_exposure() -> None:
    t = true_times()
    primary = of_primary(t, t, true_poses(), NO_LIVE, 0.5)
    poses = of_assistant(t, t + LATE_NS, primary, T_P_A)
    assert set(poses.source.tolist()) == {"rig"}
    assert poses.T_w_c == pytest.approx(assistant_poses(), abs=1e-9)
    # half a second after the last pose of the primary nothing is claimed
    assert of_assistant(t, t + 500_000_000, primary, T_P_A).source.tolist()[-5:] == ["none"] * 5
    none = FramePoses(t, np.full((FRAMES, 4, 4), np.nan), np.full(FRAMES, "none", "U16"))
    assert not of_assistant(t, t, none, T_P_A).known.any()
