"""Compute the error figures that `calm-edge eval` prints."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np

from calm_edge.evaluation import EvaluationError, cloud, live, trajectory
from calm_edge.evaluation.estimate import Estimate, read_estimate
from calm_edge.evaluation.truth import Truth, read_truth
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.polyline import path_length
from calm_edge.geometry.similarity import Similarity, align
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Float, Int

Alignment = Literal["se3", "sim3"]

# A focal length with a larger sigma counts as unobserved: its error is not evaluated.
MAX_FOCAL_SIGMA_PERCENT = 5.0
MIN_POSES = 3

_TRAJECTORY_KEYS = (
    "poses",
    "path_m",
    "truth_moves",
    "coverage_percent",
    "ate_se3_m",
    "ate_sim3_m",
    "sim3_scale",
    "ate_percent",
    "rpe_trans_percent",
    "rpe_rot_deg_per_m",
    "scale_mean",
    "scale_std",
)
_MAP_KEYS = ("map_accuracy_m", "map_completeness_m", "map_chamfer_m")


def common_origin(t_ns: Int, t_truth: Int, first_frame: tuple[int, int] | None = None) -> Int:
    """Convert stamps t_ns (N,) to the clock of the truth, t_truth (M,).

    first_frame: (number in the sequence, stamp) of the first frame, which gives the offset of a
    paced replay, where all stamps are shifted to the present. Without it, ORIGIN_NS is added if
    more poses then match the truth: stamps of calm-edge contain it, those of a TUM file of another
    program do not.
    """
    if first_frame is not None and first_frame[0] < len(t_truth):
        return np.asarray(t_ns + (t_truth[first_frame[0]] - first_frame[1]))
    shifted = t_ns + ORIGIN_NS
    ours, theirs = (len(trajectory.associate(t, t_truth)[0]) for t in (t_ns, shifted))
    return shifted if theirs > ours else t_ns


def _between(truth: Truth, first: int, last: int) -> Float:
    inside = (truth.t_ns >= first) & (truth.t_ns <= last)
    return truth.T_w_c[inside]


def at_frames(t_ns: Int, T_w_c: Float, truth: Truth) -> tuple[Float, Float]:
    """Estimated and true positions (F, 3), (F, 3) at all frames of the truth during the estimate.

    Keyframe poses are interpolated, since the paper's scale windows count frames, not keyframes.
    t_ns: (N,) of T_w_c (N, 4, 4), on the truth's clock.
    """
    inside = (truth.t_ns >= t_ns[0]) & (truth.t_ns <= t_ns[-1])
    seconds = (t_ns - t_ns[0]) / 1e9
    T = se3.interpolate_at(seconds, T_w_c, (truth.t_ns[inside] - t_ns[0]) / 1e9)
    return T[:, :3, 3], truth.T_w_c[inside, :3, 3]


def choose(estimate: Estimate, align: Alignment | None = None) -> Alignment:
    """Alignment to use: `align` if given, else SE(3) for an estimate in metres, else Sim(3)."""
    return align or ("se3" if estimate.metric else "sim3")


def _trajectory_figures(
    estimate: Estimate, truth: Truth, chosen: Alignment
) -> tuple[dict[str, float | None], Similarity]:
    t_ns = common_origin(estimate.t_ns, truth.t_ns, estimate.first_frame)
    i, j = trajectory.associate(t_ns, truth.t_ns)
    if len(i) < MIN_POSES:
        raise EvaluationError(
            f"{estimate.source}: {len(i)} poses within "
            f"{trajectory.TOLERANCE_NS / 1e6:g} ms of a true pose, {MIN_POSES} are needed; "
            "check that --truth is of this drive"
        )
    T, T_truth = estimate.T_w_c[i], truth.T_w_c[j]
    p, p_truth = T[:, :3, 3], T_truth[:, :3, 3]
    rigid = align(p, p_truth, with_scale=False)
    similar = align(p, p_truth, with_scale=True)
    between = _between(truth, truth.t_ns[j[0]], truth.t_ns[j[-1]])[:, :3, 3]
    path, moved = path_length(between), trajectory.moves(between)
    if not moved:
        # neither a scale nor a share of the path: what is left is how far the estimate wanders
        wander = trajectory.ate(rigid.points(p), p_truth) if estimate.metric else None
        known = {"poses": len(i), "path_m": path, "truth_moves": False, "ate_se3_m": wander}
        return dict.fromkeys(_TRAJECTORY_KEYS) | known, rigid
    used = rigid if chosen == "se3" else similar
    ate_rigid = trajectory.ate(rigid.points(p), p_truth)
    ate_similar = trajectory.ate(similar.points(p), p_truth)
    whole = path_length(truth.T_w_c[:, :3, 3])
    segments = trajectory.rpe(used.poses(T), T_truth)
    scales = trajectory.scale_consistency(*at_frames(t_ns, estimate.T_w_c, truth))
    figures: dict[str, float | None] = {
        "poses": len(i),
        "path_m": path,
        "truth_moves": True,
        "coverage_percent": 100 * path / whole,
        "ate_se3_m": ate_rigid,
        "ate_sim3_m": ate_similar,
        "sim3_scale": similar.scale,
        "ate_percent": 100 * (ate_rigid if chosen == "se3" else ate_similar) / path,
        "rpe_trans_percent": segments[0] if segments else None,
        "rpe_rot_deg_per_m": segments[1] if segments else None,
        "scale_mean": scales[0] if scales else None,
        "scale_std": scales[1] if scales else None,
    }
    return figures, used


def _focal_figures(
    estimate: Estimate, cameras: tuple[Camera, Camera] | None
) -> dict[str, list[float | None] | None]:
    if estimate.focal_px is None:
        keys = ("focal_px", "focal_sigma_percent", "focal_error_px", "focal_error_percent")
        return dict.fromkeys(keys)
    sigma = estimate.focal_sigma_percent or (None, None)
    error_px: list[float | None] = [None, None]
    error_percent: list[float | None] = [None, None]
    for eye in range(2):
        observed = sigma[eye]
        if cameras is None or observed is None or observed > MAX_FOCAL_SIGMA_PERCENT:
            continue
        true = cameras[eye].fx
        error_px[eye] = estimate.focal_px[eye] - true
        error_percent[eye] = 100 * (estimate.focal_px[eye] - true) / true
    return {
        "focal_px": list(estimate.focal_px),
        "focal_sigma_percent": list(sigma),
        "focal_error_px": error_px,
        "focal_error_percent": error_percent,
    }


def _map_figures(
    estimate: Estimate, truth: Truth, motion: Similarity | None
) -> dict[str, float | None]:
    if estimate.points_w is None or truth.cloud is None or motion is None:
        return dict.fromkeys(_MAP_KEYS)
    points = motion.points(np.asarray(estimate.points_w, np.float64))
    error = cloud.compare(points, np.asarray(truth.cloud, np.float64), truth.T_w_c[:, :3, 3])
    if error is None:
        return dict.fromkeys(_MAP_KEYS)
    values = (error.accuracy_m, error.completeness_m, error.chamfer_m)
    return dict(zip(_MAP_KEYS, values, strict=True))


def _live_figures(
    estimate: Estimate, truth: Truth, motion: Similarity | None
) -> dict[str, Any] | None:
    if motion is None:
        return None
    stamps = np.array([sample.t_ns for sample in estimate.live], np.int64)
    stamps = common_origin(stamps, truth.t_ns, estimate.first_frame)
    return live.compare(estimate.live, stamps, truth.t_ns, truth.T_w_c, motion.scale)


def _plain(value: Any) -> Any:
    """Copy of a value with NaN and infinity, which JSON lacks, replaced by None."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def compare(estimate: Estimate, truth: Truth, align: Alignment | None = None) -> dict[str, Any]:
    """Error figures of an estimate against the truth; None where either lacks the data.

    align: alignment of `ate_percent`, the RPE and the map; None: SE(3) for an estimate in metres,
    else Sim(3). `poses`: number of poses compared. `coverage_percent`: share of the true path
    they span. `metre`: `Metre.summary`, None if the source has none. Focal errors are estimate
    minus truth. `live`: errors of the poses published during the drive (`live.compare`), in metres
    by the scale of the alignment. Raises EvaluationError if the two do not overlap in time.
    """
    chosen = choose(estimate, align)
    figures: dict[str, float | None] = dict.fromkeys(_TRAJECTORY_KEYS)
    motion = None
    if len(estimate.t_ns) >= MIN_POSES and len(truth.t_ns):
        figures, motion = _trajectory_figures(estimate, truth, chosen)
    result = {
        "frames": estimate.frames,
        "keyframes": estimate.keyframes,
        "submaps": estimate.submaps,
        "align": chosen,
        "spacing_m": estimate.spacing_m,
        "metre": None if estimate.metre is None else estimate.metre.summary(),
        **figures,
        **_focal_figures(estimate, truth.cameras),
        **_map_figures(estimate, truth, motion),
        "live": _live_figures(estimate, truth, motion),
        "pose_age_ms": estimate.pose_age_ms,
        "stage_ms": estimate.stage_ms or None,
    }
    plain = _plain(result)
    assert isinstance(plain, dict)
    return plain


def evaluate(target: Path, truth_folder: Path, align: Alignment | None = None) -> dict[str, Any]:
    """Evaluate a recording, a map folder or a TUM file: the keys of `calm-edge eval --json`.

    Raises EvaluationError, RecordingError, or SequenceError for a bad file of times.
    """
    truth = read_truth(Path(truth_folder))
    return compare(read_estimate(Path(target)), truth, align)
