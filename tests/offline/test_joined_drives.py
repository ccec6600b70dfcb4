"""Drives of one place in one frame, by closures of which some are false."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.config import Config, merge
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.offline.drive import Drive
from calm_edge.offline.joined_drives import (
    Joined,
    _poses,
    _scaled,
    _stretched,
    common_scales,
    join,
)
from calm_edge.offline.shared_places import STRIDE, PlacedDrive
from calm_edge.types import (
    Float,
    LocalizerUpdate,
    LoopClosure,
    Metre,
    Prediction,
    Submap,
    Trajectory,
)

CONFIG = merge(Config(), {"scale": {"spacing_m": 0.5}})
CAMERA = Perspective(300.0, 300.0, 160.0, 90.0, 320, 180)
N, SIZE, OVERLAP = 60, 8, 2
RIGS = [se3.exp(np.array([0.5, 0, 0, 0, angle, 0.01])) for angle in (0.02, -0.05, 0.03)]


def road(s: Float) -> Float:
    """Poses T (N, 4, 4) along a bent road, s metres from its start; y down, z ahead."""
    heading = 0.02 * s + 0.3 * np.sin(0.05 * s)
    fine = np.linspace(0, s.max() + 1, 4000)
    bent = 0.02 * fine + 0.3 * np.sin(0.05 * fine)
    step = np.gradient(fine)
    x, z = np.cumsum(step * np.sin(bent)), np.cumsum(step * np.cos(bent))
    p = np.stack([np.interp(s, fine, x), 0 * s, np.interp(s, fine, z)], 1)
    zero = np.zeros(len(s))
    return se3.compose(se3.so3_exp(np.stack([zero, heading, zero], 1)), p)


def truth(n: int) -> Float:
    """True poses (N, 4, 4) of drive n, which begins 12 m later than the one before."""
    return road(12.0 * n + 1.0 * np.arange(N))


def drive(n: int, seed: int) -> PlacedDrive:
    """Sub-maps of drive n in its own world, with a drift of the whole path."""
    rng = np.random.default_rng(seed)
    T = se3.inverse(truth(n)[0]) @ truth(n)
    steps = se3.inverse(T[:-1]) @ T[1:]
    steps = steps @ se3.exp(rng.normal(0, [0.01] * 3 + [0.0005] * 3, (N - 1, 6)))
    path = [np.eye(4)]
    for step in steps:
        path.append(path[-1] @ step)
    T_w_p = np.stack(path)
    t_ns = 10**9 + 3 * 10**8 * np.arange(N)
    found = Drive()
    for k, first in enumerate(range(0, N - SIZE + 1, SIZE - OVERLAP)):
        ids = tuple(range(first, first + SIZE))
        T_w_s = T_w_p[first]
        T_s_p = se3.inverse(T_w_s) @ T_w_p[first : first + SIZE]
        T_s_c = np.concatenate([T_s_p, T_s_p @ RIGS[n]])
        cameras = (CAMERA,) * (2 * SIZE)
        times = np.tile(t_ns[first : first + SIZE], 2)
        submap = Submap(
            k, ids, ids, OVERLAP, times, T_s_c, cameras, T_s_c, cameras, 1.0, T_w_s, np.zeros(2)
        )
        own = Trajectory(np.array(ids), t_ns[list(ids)], T_w_p[list(ids)], RIGS[n], 0)
        found.updates.append(LocalizerUpdate(submap, Prediction(cameras, T_s_c), own))
    last = found.updates[-1].submap.primary_ids[-1] + 1
    found.metre = Metre(0.01)
    found.trajectory = Trajectory(np.arange(last), t_ns[:last], T_w_p[:last], RIGS[n], 0)
    recording: Any = Path(f"drive-{n}")
    return PlacedDrive(recording, found)


def closure(query: tuple[int, int], match: tuple[int, int], seed: int) -> LoopClosure:
    """Closure between keyframes (drive, id), measured to 5 cm."""
    rng = np.random.default_rng(seed)
    noise = se3.exp(rng.normal(0, [0.05] * 3 + [0.003] * 3))
    T_match_query = se3.inverse(truth(match[0])[match[1]]) @ truth(query[0])[query[1]] @ noise
    return LoopClosure(STRIDE * query[0] + query[1], STRIDE * match[0] + match[1], T_match_query)


def true_closures(a: int, b: int) -> list[LoopClosure]:
    """Every tenth keyframe of drive b that drive a passes too."""
    return [closure((b, k), (a, k + 12 * (b - a)), k) for k in range(0, N - 24, 10)]


def false_closure(a: int, b: int, seed: int) -> LoopClosure:
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(0, [5.0, 1, 5, 0.1, 0.6, 0.1]))
    return LoopClosure(STRIDE * b + int(rng.integers(50)), STRIDE * a + int(rng.integers(50)), T)


def errors(joined: Joined, n: int) -> Float:
    """Distances (N,) of drive n's keyframes from the truth, in the frame of drive 0."""
    found = joined.drives[n].trajectory
    assert found is not None
    wanted = se3.inverse(truth(0)[0]) @ truth(n)[: len(found.T_w_c)]
    return np.asarray(np.linalg.norm((found.T_w_c - wanted)[:, :3, 3], axis=1))


def alone(n: int, seed: int) -> Float:
    placed = drive(n, seed).drive.trajectory
    assert placed is not None
    wanted = (se3.inverse(truth(n)[0]) @ truth(n))[: len(placed.T_w_c)]
    return np.asarray(np.linalg.norm((placed.T_w_c - wanted)[:, :3, 3], axis=1))


def test_two_drives_of_two_kits_come_into_one_frame_despite_false_closures() -> None:
    drives = [drive(0, 1), drive(1, 2)]
    closures = [*true_closures(0, 1), *(false_closure(0, 1, k) for k in range(3))]
    joined = join(drives, closures, CONFIG)
    assert joined.apart == () and joined.used == {(0, 1): len(true_closures(0, 1))}
    both = np.concatenate([errors(joined, 0), errors(joined, 1)])
    single = max(np.sqrt(np.mean(alone(n, n + 1) ** 2)) for n in (0, 1))
    assert np.sqrt(np.mean(both**2)) < 1.5 * single + 0.1
    # sub-maps moved with the keyframes, and the drives keep their own ids
    moved = joined.drives[1]
    assert moved.trajectory is not None and moved.trajectory.keyframe_ids.max() < N
    first = moved.updates[3].submap
    at = moved.trajectory.T_w_c[first.primary_ids[0]]
    assert np.linalg.norm((first.T_w_c()[0] - at)[:3, 3]) < 0.3
    assert first.kit_epoch == 0 and first.id == 3


def test_a_third_drive_is_joined_by_way_of_the_second() -> None:
    drives = [drive(n, n + 5) for n in range(3)]
    closures = [*true_closures(1, 2), *true_closures(0, 1)]
    joined = join(drives, closures, CONFIG)
    assert sorted(joined.drives) == [0, 1, 2]
    assert errors(joined, 2).max() < 2.0


@pytest.mark.parametrize(
    "closures",
    [[], true_closures(0, 1)[:1], [false_closure(0, 1, k) for k in range(5)]],
    ids=["none", "one", "false"],
)
def test_a_drive_without_agreeing_closures_is_apart(closures: list[LoopClosure]) -> None:
    drives = [drive(0, 1), drive(1, 2)]
    joined = join(drives, closures, CONFIG)
    assert joined.apart == (1,) and list(joined.drives) == [0] and not joined.used
    assert joined.drives[0] is drives[0].drive


def test_closures_of_unknown_keyframes_are_ignored() -> None:
    unknown = replace(true_closures(0, 1)[0], match_id=999)
    joined = join([drive(0, 1), drive(1, 2)], [unknown, *true_closures(0, 1)[1:]], CONFIG)
    assert joined.used == {(0, 1): len(true_closures(0, 1)) - 1}


def test_lengths_of_the_drives_are_made_to_agree_and_a_disagreement_is_said() -> None:
    long, short = drive(0, 1), drive(1, 2)
    for factor, disagree in ((1.01, False), (1.3, True)):
        stretched = PlacedDrive(short.recording, _scaled(short.drive, factor))
        closures = [
            replace(c, T_match_query=_stretched(c.T_match_query, factor))
            for c in true_closures(0, 1)
        ]
        poses = _poses([long, stretched])
        scales, notes = common_scales([long, stretched], closures, poses)
        assert abs(np.log(scales[0] / scales[1]) - np.log(factor)) < 0.015
        assert abs(np.log(scales[0] * scales[1])) < 0.01
        assert bool(notes) is disagree and all("spacing_m" in note for note in notes)
