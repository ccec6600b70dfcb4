"""Trajectory errors: association by stamps, ATE, RPE and scale consistency.

Poses are T_w_c (N, 4, 4), camera -> world. The truth is in metres.
"""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Int

SEGMENT_M = 10.0
WINDOW_FRAMES = 100
WINDOW_STRIDE = 5
TOLERANCE_NS = 10_000_000
# A path that stays within this distance of its start is a standstill.
STANDSTILL_M = 0.1
# Smallest RMS distance of true positions from their mean that has a scale to compare: standing, or
# creeping, the estimate's noise is as large.
LEAST_SPREAD_M = 0.5


def associate(t: Int, t_truth: Int, tolerance_ns: int = TOLERANCE_NS) -> tuple[Int, Int]:
    """Match each stamp [ns] to the nearest true stamp, one to one: indices (M,) of t, of t_truth.

    Both sorted. Stamps further than the tolerance from any true one are left out; if several have
    the same nearest true stamp, only the closest of them is kept.
    """
    if len(t) == 0 or len(t_truth) == 0:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    right = np.clip(np.searchsorted(t_truth, t), 1, max(len(t_truth) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(t_truth) - 1)
    nearest = np.where(np.abs(t - t_truth[left]) <= np.abs(t_truth[right] - t), left, right)
    gap = np.abs(t - t_truth[nearest])
    best: dict[int, int] = {}
    for i in np.flatnonzero(gap <= tolerance_ns):
        j = int(nearest[i])
        if j not in best or gap[i] < gap[best[j]]:
            best[j] = int(i)
    pairs = sorted((i, j) for j, i in best.items())
    index = np.array(pairs, np.int64).reshape(-1, 2)
    return index[:, 0], index[:, 1]


def moves(p: Float) -> bool:
    """Whether a true path p (N, 3), metres, leaves its start."""
    return len(p) > 0 and bool(np.linalg.norm(p - p[0], axis=1).max() >= STANDSTILL_M)


def ate(p: Float, p_truth: Float) -> float:
    """Absolute trajectory error: RMS distance of aligned positions (N, 3) to true ones (N, 3)."""
    return float(np.sqrt(((p - p_truth) ** 2).sum(1).mean()))


def rpe(T: Float, T_truth: Float, segment_m: float = SEGMENT_M) -> tuple[float, float] | None:
    """Relative pose error over path segments, mean of (% of the length, degrees per metre).

    A segment goes from each pose i to the first pose j at least `segment_m` further along the
    true path; error = (truth_i^-1 truth_j)^-1 (T_i^-1 T_j), translation and angle divided by the
    segment's length (the KITTI odometry metric of Geiger et al., 2012, with shorter segments).
    T: (N, 4, 4) in metres. None if the path is shorter than one segment.
    """
    steps = np.linalg.norm(np.diff(T_truth[:, :3, 3], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    end = np.searchsorted(along, along + segment_m - 1e-9)
    start = np.flatnonzero(end < len(along))
    if len(start) == 0:
        return None
    end = end[start]
    length = along[end] - along[start]
    moved = se3.inverse(T[start]) @ T[end]
    moved_truth = se3.inverse(T_truth[start]) @ T_truth[end]
    error = se3.inverse(moved_truth) @ moved
    trans = np.linalg.norm(error[:, :3, 3], axis=1) / length
    angle = np.linalg.norm(se3.so3_log(error[:, :3, :3]), axis=1) / length
    return float(100 * trans.mean()), float(np.degrees(angle.mean()))


def window_scales(
    p: Float, p_truth: Float, window: int = WINDOW_FRAMES, stride: int = WINDOW_STRIDE
) -> tuple[Int, Float]:
    """Scale (W,) of the estimate in sliding windows, relative to that in the first window.

    Returns the first frame of each window (W,), and the scales. p, p_truth: (N, 3) estimated and
    true positions [m] of the same frames. The scale of a window is the RMS distance of its
    positions from their mean, estimated over true; unlike a least-squares scale it is not biased
    low by noise. Windows almost without motion are left out. window, stride: frames, by default
    those of paper VII (scale consistency).
    """
    starts, scales = [], []
    for i in range(0, len(p) - window + 1, stride):
        spread = _spread(p[i : i + window])
        spread_truth = _spread(p_truth[i : i + window])
        if spread > 0 and spread_truth >= LEAST_SPREAD_M:
            starts.append(i)
            scales.append(spread / spread_truth)
    relative = np.array(scales) / scales[0] if scales else np.zeros(0)
    return np.array(starts, np.int64), relative


def _spread(p: Float) -> float:
    """RMS distance of positions (N, 3) from their mean."""
    return float(np.sqrt(((p - p.mean(0)) ** 2).sum(1).mean()))


def scale_consistency(p: Float, p_truth: Float) -> tuple[float, float] | None:
    """Return (mean |scale - 1|, standard deviation) of `window_scales`, small is good (paper VII).

    Scales are relative to that of the first window: (0, 0) if the scale does not drift, even if it
    is wrong. p, p_truth: as for `window_scales`. None with fewer than two windows, the second of
    which ends at frame WINDOW_FRAMES + WINDOW_STRIDE = 105.
    """
    if len(p) < WINDOW_FRAMES + WINDOW_STRIDE:
        return None
    _, scales = window_scales(p, p_truth)
    if len(scales) < 2:
        return None
    return float(np.abs(scales - 1).mean()), float(scales.std())
