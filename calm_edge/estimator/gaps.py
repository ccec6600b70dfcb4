"""Gaps of the path: where no picture connects what is before with what is after.

There the camera was covered, the frames are missing, or the views do not overlap. The later part is
placed by constant velocity. That is a guess, with a sigma that grows with the time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from calm_edge.types import Landmarks, LoopClosure, Submap

# Landmarks seen on both sides of a cut that join it, at least, and as share of the median over the
# window's other places; wrong matches give some, the more the more features there are.
MIN_LINKS, MIN_LINK_SHARE = 5, 0.1
# sigmas of what a car does meanwhile: m/s², or spacings/s² if the spacing is not known; rad/s
ACCELERATION_M, ACCELERATION_SPACINGS = 3.0, 6.0
TURN_RATE = 0.5
# rad: a direction that is not known at all
UNKNOWN_DIRECTION = np.pi / np.sqrt(3)


@dataclass(frozen=True, slots=True)
class Gap:
    """Two consecutive keyframes that no picture connects.

    before_id, after_id: their ids. start_ns: stamp of the first. seconds: time between them in
    which the car moved. sigma_translation: world units; sigma_rotation: rad; of the pose after
    relative to the pose before.
    """

    before_id: int
    after_id: int
    start_ns: int
    seconds: float
    sigma_translation: float
    sigma_rotation: float


def cuts(submap: Submap, landmarks: Landmarks | None) -> tuple[int, ...]:
    """Primary views of a sub-map that too few landmarks connect with those before.

    Views of the assistant lie before or after by their stamps. Empty without landmarks.
    """
    n = submap.n_primary
    if landmarks is None or n < 2:
        return ()
    views = n + len(submap.assistant_ids)
    seen = landmarks.view < views
    index, t_ns = landmarks.index[seen], submap.exposed_ns[landmarks.view[seen]]
    first = np.full(len(landmarks.points_s), np.iinfo(np.int64).max)
    last = np.full(len(landmarks.points_s), np.iinfo(np.int64).min)
    np.minimum.at(first, index, t_ns)
    np.maximum.at(last, index, t_ns)
    t_p = submap.t_ns[:n]
    middle = t_p[:-1] + (t_p[1:] - t_p[:-1]) // 2
    links = ((first[:, None] <= middle) & (last[:, None] > middle)).sum(0)
    needed = max(MIN_LINKS, MIN_LINK_SHARE * float(np.median(links)))
    return tuple((np.flatnonzero(links < needed) + 1).tolist())


def uncertainty(seconds: float, speed: float, acceleration: float) -> tuple[float, float]:
    """Sigmas of a pose predicted by constant velocity: translation (units of speed · s), rad.

    A turn at an unknown rate bends the path: on average the direction is off by half of its end's.
    """
    rotation = min(TURN_RATE * seconds, UNKNOWN_DIRECTION)
    sideways = speed * seconds * rotation / 2
    return float(np.hypot(acceleration * seconds**2 / 2, sideways)), float(rotation)


def acceleration(spacing: float, *, metric: bool) -> float:
    """Sigma of a car's acceleration, world units / s². spacing: of the cameras, world units."""
    return ACCELERATION_M if metric else ACCELERATION_SPACINGS * spacing


def find(
    submaps: Sequence[Submap], loops: Iterable[LoopClosure], acceleration: float
) -> tuple[Gap, ...]:
    """All gaps of placed sub-maps, in order of time, that no loop closes.

    acceleration: sigma, world units / s².
    """
    found: dict[tuple[int, int], Gap] = {}
    known = [sorted((loop.match_id, loop.query_id)) for loop in loops]
    for k, submap in enumerate(submaps):
        if submap.bridged_s:
            before = submaps[k - 1]
            last = before.n_primary - 1
            ids = before.primary_ids[-1], submap.primary_ids[0]
            sigmas = uncertainty(submap.bridged_s, speed(before, last), acceleration)
            found[ids] = Gap(*ids, int(before.t_ns[last]), submap.bridged_s, *sigmas)
        for cut in submap.cuts:
            ids = submap.primary_ids[cut - 1], submap.primary_ids[cut]
            start_ns, end_ns = submap.t_ns[cut - 1 : cut + 1].tolist()
            seconds = (end_ns - start_ns) * 1e-9
            sigmas = uncertainty(seconds, speed(submap, cut - 1), acceleration)
            found[ids] = Gap(*ids, start_ns, seconds, *sigmas)
    return tuple(
        gap
        for (before_id, after_id), gap in sorted(found.items())
        if not any(low <= before_id and after_id <= high for low, high in known)
    )


def described(gaps: Sequence[Gap], start_ns: int, *, metric: bool) -> str:
    """One line for the user: when, how long, and how well the rest of the path is known.

    start_ns: stamp of the drive's first keyframe.
    """
    total = sum(gap.seconds for gap in gaps)
    at_s = (gaps[0].start_ns - start_ns) // 1_000_000_000
    unit = "m" if metric else "units"
    translation = np.sqrt(sum(gap.sigma_translation**2 for gap in gaps))
    rotation = np.degrees(np.sqrt(sum(gap.sigma_rotation**2 for gap in gaps)))
    several = f"{len(gaps)} gaps, the first" if len(gaps) > 1 else "a gap"
    return (
        f"no picture connects the path across {several} at {at_s // 60}:{at_s % 60:02d} "
        f"({total:.1f} s in all): what follows is placed by constant velocity, "
        f"sigma {translation:.2g} {unit} and {min(rotation, 180):.0f} degrees"
    )


def speed(submap: Submap, view: int) -> float:
    """Speed at a primary view, world units / s: of the step before it, else of the one after."""
    n = submap.n_primary
    a, b = (view - 1, view) if view else (0, min(1, n - 1))
    if a == b:
        return 0.0
    step = submap.T_s_c[b, :3, 3] - submap.T_s_c[a, :3, 3]
    return float(np.linalg.norm(step) / ((submap.t_ns[b] - submap.t_ns[a]) * 1e-9))
