"""Errors of the poses published during the drive, before any later optimisation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calm_edge.evaluation import trajectory
from calm_edge.evaluation.motion_covariance import motion_covariance
from calm_edge.geometry import se3
from calm_edge.types import Float, Int, PoseSample, PoseStatus

SPAN_NS = 1_000_000_000
# Pairs further apart than this many spans are not used: poses are missing between them.
LONGEST_SPAN = 1.25


def parts(samples: Sequence[PoseSample]) -> Int:
    """Number the parts (N,) of a drive, in order, within which relative motion is claimed.

    At a new epoch poses jump, and a path that is not metric in between has no known length.
    """
    unscaled = np.array([s.status is PoseStatus.UNSCALED for s in samples], np.int64)
    resumed = np.diff(unscaled, prepend=0) < 0
    epoch = np.array([s.epoch for s in samples], np.int64)
    return np.cumsum(resumed | (np.diff(epoch, prepend=epoch[:1]) != 0), dtype=np.int64)


def spans(t_ns: Int, part: Int, span_ns: int = SPAN_NS) -> tuple[Int, Int]:
    """Pair each stamp with the first one at least `span_ns` later, in the same part of the drive.

    Returns the indices (S,) of the earlier and (S,) of the later stamps. t_ns: (N,) sorted. part:
    (N,) of the poses at t_ns.
    """
    j = np.searchsorted(t_ns, t_ns + span_ns - trajectory.TOLERANCE_NS)
    i = np.flatnonzero(j < len(t_ns))
    j = j[i]
    near = t_ns[j] - t_ns[i] <= LONGEST_SPAN * span_ns
    near &= part[i] == part[j]
    return i[near], j[near]


def _median(values: Float) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else None


def _percentiles(values: Float) -> dict[str, float] | None:
    if len(values) == 0:
        return None
    p50, p90, most = np.percentile(values, [50, 90, 100])
    return {"p50": float(p50), "p90": float(p90), "max": float(most)}


def compare(
    samples: Sequence[PoseSample], t_ns: Int, t_truth: Int, T_truth: Float, scale: float = 1.0
) -> dict[str, Any] | None:
    """Compare the live poses of a drive with the truth; None without samples.

    t_ns: (N,) the samples' stamps on the truth's clock, sorted. T_truth: (M, 4, 4) at t_truth
    (M,), metres. scale: metres per world unit. Keys of the result:
    first_s: time from the first frame to the first pose (LIVE or LAGGING); None without any, and
    then the keys below are missing. live_percent: share of frames with a pose, since the first
    pose. longest_gap_s: longest time without a pose. jumps: number of new epochs. span_m,
    span_deg: {p50, p90, max} translation and rotation error of the relative motion over 1 s;
    span_percent: mean of span_m in percent of the mean true distance over 1 s. span_sigma_m: median
    claimed sigma of that translation. velocity_m_s: {p50, p90, max} of |estimated - true velocity|,
    the latter from central differences of the true positions; velocity_sigma_m_s: median claimed
    sigma of it. Sigmas are roots of summed variances; None if unknown.
    """
    if not samples:
        return None
    live = np.array([s.status.usable for s in samples])
    if not live.any():
        return {"frames": len(samples), "first_s": None}
    first = int(np.argmax(live))
    stamps = t_ns[live]
    ends = np.append(stamps, t_ns[-1])
    epoch = np.array([s.epoch for s in samples], np.int64)[live]
    result: dict[str, Any] = {
        "frames": len(samples),
        "first_s": float(t_ns[first] - t_ns[0]) / 1e9,
        "live_percent": 100 * float(live[first:].mean()),
        "longest_gap_s": float(np.diff(ends).max()) / 1e9,
        "jumps": int(epoch[-1] - epoch[0]),
    }
    a, b = trajectory.associate(stamps, t_truth)
    known = [sample for sample, is_live in zip(samples, live, strict=True) if is_live]
    compared = [known[k] for k in a]
    T = np.array([s.T_w_c for s in compared]).reshape(-1, 4, 4)
    T[:, :3, 3] *= scale
    i, j = spans(stamps[a], parts(samples)[live][a])
    true = se3.inverse(T_truth[b[i]]) @ T_truth[b[j]]
    error = se3.inverse(true) @ se3.inverse(T[i]) @ T[j]
    distance = np.linalg.norm(error[:, :3, 3], axis=-1)
    length = float(np.linalg.norm(true[:, :3, 3], axis=-1).sum())
    result["span_m"] = _percentiles(distance)
    result["span_percent"] = 100 * float(distance.sum()) / length if length > 0 else None
    result["span_deg"] = _percentiles(
        np.degrees(np.linalg.norm(se3.so3_log(error[:, :3, :3]), axis=-1))
    )
    claimed = [
        np.trace(motion_covariance(compared[first], compared[then])[:3, :3])
        for first, then in zip(i, j, strict=True)
    ]
    result["span_sigma_m"] = _median(scale * np.sqrt(claimed))
    velocity = scale * np.array([s.velocity_c for s in compared]).reshape(-1, 3)
    inside = (b > 0) & (b < len(t_truth) - 1) & np.isfinite(velocity).all(1)
    before, now, after = b[inside] - 1, b[inside], b[inside] + 1
    moved = (T_truth[after] - T_truth[before])[:, :3, 3]
    moved /= ((t_truth[after] - t_truth[before]) / 1e9)[:, None]
    rate = (np.swapaxes(T_truth[now, :3, :3], -1, -2) @ moved[..., None])[..., 0]
    result["velocity_m_s"] = _percentiles(np.linalg.norm(velocity[inside] - rate, axis=-1))
    variance = np.array([np.trace(s.with_drift()[1][:3, :3]) for s in compared])[inside]
    result["velocity_sigma_m_s"] = _median(scale * np.sqrt(variance))
    return result
