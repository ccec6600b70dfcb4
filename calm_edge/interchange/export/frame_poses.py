"""Poses of all frames of both cameras from the optimised poses of keyframes.

A frame between two keyframes takes the relative motion of the live tracker, which is tied to both:
it is composed with the pose of the keyframe before and with that of the one after, and the two
results are interpolated. The drift of the live pose, that of its scale too, is thereby removed. Its
position is noisy where the scene is far: it is weighted with that interpolated between the
keyframes, by the covariances of both.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.types import Float, Int

# Longest time between poses that is interpolated, unless the car stood still meanwhile.
MAX_GAP_NS = 2_000_000_000
# Longest time by which a pose is extrapolated.
MAX_BEYOND_NS = 60_000_000
# Live motion is not used where it differs from that of the keyframes by a larger share of it, or
# by a larger angle: the tracker was wrong there.
MAX_MISMATCH, MAX_TURN_RAD = 0.5, 0.1
# spacings: shorter motion is a standstill
STANDS = 0.2
# spacings/s²: sigma of the acceleration that interpolation neglects, 3 m/s² at a spacing of 0.5 m
ACCELERATION = 6.0


class PoseSource(StrEnum):
    """Where the pose of a frame is from.

    KEYFRAME: optimised. TRACKED: of the live tracker, tied to keyframes. INTERPOLATED: between
    keyframes. RIG: pose of the primary at the same time, and the rig. NONE: no pose.
    """

    KEYFRAME = "keyframe"
    TRACKED = "tracked"
    INTERPOLATED = "interpolated"
    RIG = "rig"
    NONE = "none"


@dataclass(frozen=True, slots=True)
class FramePoses:
    """Poses of all frames of an eye, sorted: t_ns (F,), T_w_c (F, 4, 4), NaN without a pose."""

    t_ns: Int
    T_w_c: Float
    source: NDArray[np.str_]

    @property
    def known(self) -> NDArray[np.bool_]:
        """Frames (F,) with a pose."""
        return np.asarray(self.source != PoseSource.NONE)

    def counts(self) -> str:
        """Number of frames by source of their pose, in words."""
        found = [(source, int((self.source == source).sum())) for source in PoseSource]
        return ", ".join(f"{n} {source}" for source, n in found if n)


@dataclass(frozen=True, slots=True)
class LivePoses:
    """Live poses: t_ns (L,) sorted, T_w_c (L, 4, 4), epoch (L,) within which they do not jump.

    covariance: (L, 3, 3) of the position in camera axes, NaN if unknown.
    """

    t_ns: Int
    T_w_c: Float
    epoch: Int
    covariance: Float


def of_primary(
    t_ns: Int, keyframe_ns: Int, T_w_k: Float, live: LivePoses, spacing: float
) -> FramePoses:
    """Poses of the primary's frames at t_ns (F,), sorted.

    keyframe_ns (K,) sorted, T_w_k (K, 4, 4): optimised poses. spacing: in world units.
    """
    T = np.full((len(t_ns), 4, 4), np.nan)
    source = np.full(len(t_ns), PoseSource.NONE.value, "U16")
    if not len(keyframe_ns):
        return FramePoses(t_ns, T, source)
    before = np.clip(np.searchsorted(keyframe_ns, t_ns, "right") - 1, 0, None)
    after = np.clip(np.searchsorted(keyframe_ns, t_ns, "left"), None, len(keyframe_ns) - 1)
    # beyond either end both are the same keyframe
    before, after = np.minimum(before, after), np.maximum(before, after)
    inside = (keyframe_ns[before] <= t_ns) & (t_ns <= keyframe_ns[after])
    span = keyframe_ns[after] - keyframe_ns[before]
    alpha = (t_ns - keyframe_ns[before]) / np.maximum(span, 1)
    alpha = np.where(inside & (span > 0), alpha, 0.0)
    step = se3.inverse(T_w_k[before]) @ T_w_k[after]
    stands = np.linalg.norm(step[:, :3, 3], axis=1) <= STANDS * spacing

    tracked = _tied(t_ns, keyframe_ns, T_w_k, before, after, live, spacing)
    followed = tracked >= 0
    if followed.any():
        row, first, second = tracked[followed], before[followed], after[followed]
        L = live.T_w_c[row]
        L_first, L_second = (
            live.T_w_c[_rows(live.t_ns, keyframe_ns[k])[0]] for k in (first, second)
        )
        forward = T_w_k[first] @ se3.inverse(L_first) @ L
        backward = T_w_k[second] @ se3.inverse(L_second) @ L
        tied = se3.interpolate(forward, backward, alpha[followed])
        between = se3.interpolate(T_w_k[first], T_w_k[second], alpha[followed])
        # what tying corrected: of a random walk, alpha (1 - alpha) of its variance is left between
        missed = (backward - forward)[:, :3, 3] * np.sqrt(alpha * (1 - alpha))[followed, None]
        R = tied[:, :3, :3]
        C = R @ live.covariance[row] @ np.swapaxes(R, 1, 2)
        C += missed[:, :, None] * missed[:, None, :]
        T[followed] = _weighted(tied, between, C, alpha[followed], span[followed] / 1e9, spacing)
        source[followed] = PoseSource.TRACKED
    rest = ~followed & inside & (span > 0) & ((span <= MAX_GAP_NS) | stands)
    T[rest] = se3.interpolate(T_w_k[before[rest]], T_w_k[after[rest]], alpha[rest])
    source[rest] = PoseSource.INTERPOLATED
    exact = keyframe_ns[before] == t_ns
    T[exact], source[exact] = T_w_k[before[exact]], PoseSource.KEYFRAME
    return FramePoses(t_ns, T, source)


def _tied(
    t_ns: Int,
    keyframe_ns: Int,
    T_w_k: Float,
    before: Int,
    after: Int,
    live: LivePoses,
    spacing: float,
) -> Int:
    """Row (F,) of the live pose by which each frame is tied to its keyframes; -1: by none."""
    if not len(live.t_ns):
        return np.full(len(t_ns), -1, np.int64)
    row, found = _rows(live.t_ns, t_ns)
    a, has_a = _rows(live.t_ns, keyframe_ns[before])
    b, has_b = _rows(live.t_ns, keyframe_ns[after])
    same = (live.epoch[a] == live.epoch[row]) & (live.epoch[b] == live.epoch[row])
    step = se3.inverse(T_w_k[before]) @ T_w_k[after]
    moved = se3.inverse(live.T_w_c[a]) @ live.T_w_c[b]
    apart = np.linalg.norm((step - moved)[:, :3, 3], axis=1)
    turned = np.linalg.norm(se3.so3_log((se3.inverse(step) @ moved)[:, :3, :3]), axis=1)
    length = np.linalg.norm(step[:, :3, 3], axis=1)
    agree = (apart <= MAX_MISMATCH * length + STANDS * spacing) & (turned <= MAX_TURN_RAD)
    return np.where(found & has_a & has_b & same & agree, row, -1)


def _weighted(
    tied: Float, between: Float, covariance: Float, alpha: Float, span_s: Float, spacing: float
) -> Float:
    """Poses (M, 4, 4) with the rotation of `tied` and the weighted mean of both positions.

    covariance: (M, 3, 3) of the position of `tied`; if unknown, `tied` counts alone.
    alpha, span_s: (M,) place between the keyframes, and their distance in time. Beyond the last
    keyframe (span 0) there is no other position.
    """
    sigma = ACCELERATION * spacing * alpha * (1 - alpha) * span_s**2 / 2
    used = np.isfinite(covariance).all((1, 2)) & (sigma > 0)
    other = np.eye(3) * sigma[used, None, None] ** 2
    apart = (tied - between)[used, :3, 3]
    T = tied.copy()
    kept = other @ np.linalg.solve(covariance[used] + other, apart[..., None])
    T[used, :3, 3] = between[used, :3, 3] + kept[..., 0]
    return T


def _rows(t: Int, wanted: Int) -> tuple[Int, NDArray[np.bool_]]:
    """Indices (M,) of stamps wanted (M,) in sorted t (L,), and whether each is there."""
    row = np.minimum(np.searchsorted(t, wanted), len(t) - 1)
    return row, np.asarray(t[row] == wanted)


def of_assistant(t_ns: Int, exposed_ns: Int, primary: FramePoses, T_p_a: Float) -> FramePoses:
    """Poses of the assistant's frames at t_ns (F,), exposed at exposed_ns (F,) on the same clock.

    T_p_a: (4, 4) rig in world units.
    """
    T = np.full((len(t_ns), 4, 4), np.nan)
    source = np.full(len(t_ns), PoseSource.NONE.value, "U16")
    known = primary.known
    if known.sum() >= 2:
        t, T_w_p = primary.t_ns[known], primary.T_w_c[known]
        left = np.clip(np.searchsorted(t, exposed_ns, "right") - 1, 0, len(t) - 2)
        beyond = np.maximum(t[0] - exposed_ns, exposed_ns - t[-1])
        near = (t[left + 1] - t[left] <= MAX_GAP_NS) & (beyond <= MAX_BEYOND_NS)
        seconds = (t - t[0]) / 1e9
        at = (exposed_ns[near] - t[0]) / 1e9
        T[near] = se3.interpolate_at(seconds, T_w_p, at) @ T_p_a
        source[near] = PoseSource.RIG
    return FramePoses(t_ns, T, source)
