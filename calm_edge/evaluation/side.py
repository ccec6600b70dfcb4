"""One side of a comparison: a recording, a map folder or a TUM file, with its figures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.estimate import Estimate, read_estimate, recorded
from calm_edge.evaluation.results import compare
from calm_edge.evaluation.truth import Truth, read_truth
from calm_edge.geometry import se3
from calm_edge.geometry.polyline import path_length
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import IMAGE_TOPICS, STATUS
from calm_edge.recording.segment import recording_files
from calm_edge.types import Float, Int, LocalizerUpdate
from device.frame import Eye

# folder of the true poses in an imported recording
TRUTH = "truth"
# of the errors against the truth
ERRORS = {
    "ate_se3_m": ("trajectory error, SE(3)", "m"),
    "ate_sim3_m": ("trajectory error, Sim(3)", "m"),
    "ate_percent": ("trajectory error", "%"),
    "sim3_scale": ("scale, estimate / truth", ""),
    "rpe_trans_percent": ("error over 10 m", "%"),
    "map_chamfer_m": ("map error, Chamfer", "m"),
}
COUNTS = (
    *("windows", "lost_poses", "unscaled_poses", "late_poses", "camera_drops", "corrupt"),
    *("untracked", "clamped_stamps", "estimator_restarts", "tracker_restarts"),
)


@dataclass(frozen=True, slots=True)
class Figure:
    """A value with the name and unit to print, and the part of the table that it is in."""

    group: str
    name: str
    unit: str
    value: float | str


@dataclass(frozen=True, slots=True)
class Side:
    """What is compared. t_ns: (N,) stamps of the source of estimate.T_w_c. figures: key -> value.

    missing: lines on what could not be read.
    """

    path: Path
    kind: str
    estimate: Estimate
    t_ns: Int
    figures: Mapping[str, Figure]
    missing: tuple[str, ...] = ()


def read_side(path: Path, truth_folder: Path | None) -> Side:
    """Read a recording, a map or a TUM file.

    truth_folder: true poses; None: those of an imported recording, if it has some. Raises
    EvaluationError, RecordingError.
    """
    if (path / "trajectory.tum").is_file():
        return _map(path, truth_folder)
    if path.is_file() and path.suffix not in {".mcap", ".part"}:
        estimate = read_estimate(path)
        return _side(path, "trajectory", estimate, estimate.t_ns, {}, truth_folder)
    recording = Recording(path)
    updates = list(recording.updates())
    estimate = recorded(recording, updates)
    figures = _kit(updates) | _recording(recording)
    t_ns = estimate.t_ns - recording.origin_ns
    missing = tuple(recording.losses)
    folder = truth_folder or _own_truth(recording.path)
    return _side(path, "recording", estimate, t_ns, figures, folder, missing)


def _map(path: Path, truth_folder: Path | None) -> Side:
    estimate = read_estimate(path)
    summary = json.loads((path / "summary.json").read_text())
    figures: dict[str, Figure] = {}
    if isinstance(T_p_a := summary.get("T_p_a"), list):
        figures |= _rig(np.array(T_p_a, np.float64))
    seams = summary.get("seams") or {}
    for key in ("median_before", "median_after"):
        if key in seams:
            name = f"sub-maps apart, {key.removeprefix('median_')} deformation"
            figures[f"seam_{key}"] = Figure("map", name, _unit(estimate), seams[key])
    figures["gaps"] = Figure("path", "gaps", "", float(len(summary.get("gaps") or ())))
    for stage, seconds in (summary.get("map_s") or {}).items():
        figures[f"map_s.{stage}"] = Figure("time of the map", stage, "s", float(seconds))
    recorded_at = Path(str(summary.get("recording", "")))
    return _side(
        path, "map", estimate, estimate.t_ns, figures, truth_folder or _own_truth(recorded_at)
    )


def _own_truth(recording: Path) -> Path | None:
    folder = recording / TRUTH
    return folder if folder.is_dir() else None


def _unit(estimate: Estimate) -> str:
    return "m" if estimate.metric else "units" if estimate.spacing_m else "spacings"


def _side(
    path: Path,
    kind: str,
    estimate: Estimate,
    t_ns: Int,
    own: Mapping[str, Figure],
    truth_folder: Path | None,
    missing: tuple[str, ...] = (),
) -> Side:
    figures = _estimate(estimate) | dict(own)
    if truth_folder is not None:
        try:
            figures |= _errors(estimate, read_truth(truth_folder))
        except EvaluationError as error:
            missing += (f"not compared with the truth: {error}",)
    for stage, ms in estimate.stage_ms.items():
        figures[f"stage_ms.{stage}"] = Figure("time per sub-map", stage, "ms", ms)
    return Side(path, kind, estimate, t_ns, figures, missing)


def _estimate(estimate: Estimate) -> dict[str, Figure]:
    unit, p = _unit(estimate), estimate.T_w_c[:, :3, 3]
    seconds = float(estimate.t_ns[-1] - estimate.t_ns[0]) / 1e9 if len(p) else 0.0
    found: dict[str, tuple[str, str, str, float | None]] = {
        "duration_s": ("path", "duration", "s", seconds),
        "length": ("path", "length", unit, path_length(p)),
        "frames": ("path", "frames of the primary", "", estimate.frames),
        "keyframes": ("path", "keyframes", "", estimate.keyframes),
        "submaps": ("path", "sub-maps", "", estimate.submaps),
        "spacing_m": ("kit", "spacing as given", "m", estimate.spacing_m),
    }
    for eye, name in enumerate(("primary", "assistant")):
        if estimate.focal_px is not None:
            focal = ("kit", f"focal length, {name}", "px", estimate.focal_px[eye])
            found[f"focal_{name}_px"] = focal
        if estimate.focal_sigma_percent is not None:
            sigma = estimate.focal_sigma_percent[eye]
            found[f"focal_{name}_sigma_percent"] = ("kit", f"its sigma, {name}", "%", sigma)
    if estimate.metre is not None and np.isfinite(estimate.metre.log_sigma):
        sigma = 100 * estimate.metre.log_sigma
        found["metre_sigma_percent"] = ("kit", "sigma of lengths", "%", sigma)
    for key, ms in (estimate.pose_age_ms or {}).items():
        found[f"pose_age_{key}_ms"] = ("live", f"pose age, {key}", "ms", ms)
    if estimate.points_w is not None:
        found["points"] = ("map", "points", "", len(estimate.points_w))
    return {
        key: Figure(group, name, text, float(value))
        for key, (group, name, text, value) in found.items()
        if value is not None
    }


def _errors(estimate: Estimate, truth: Truth) -> dict[str, Figure]:
    errors = compare(estimate, truth)
    return {
        key: Figure("against the truth", name, unit, float(errors[key]))
        for key, (name, unit) in ERRORS.items()
        if errors.get(key) is not None
    }


def _kit(updates: list[LocalizerUpdate]) -> dict[str, Figure]:
    """Rig and time offset of the last update, and loops of all."""
    if not updates:
        return {}
    last = updates[-1]
    closed = {(u.loop.query_id, u.loop.match_id) for u in updates if u.loop is not None}
    late_ms = last.submap.assistant_late_ns / 1e6
    figures = _rig(last.trajectory.T_p_a) if last.submap.assistant_ids else {}
    return figures | {
        "loops": Figure("path", "loops closed", "", float(len(closed))),
        "time_offset_ms": Figure("kit", "time offset of the assistant", "ms", late_ms),
    }


def _rig(T_p_a: Float) -> dict[str, Figure]:
    """Rotation between the cameras and direction to the assistant, in degrees."""
    axis = np.degrees(se3.so3_log(T_p_a[:3, :3]))
    found = {
        f"rig_rotation_{name}_deg": Figure("kit", f"rig, rotation about {name}", "deg", float(v))
        for name, v in zip("xyz", axis, strict=True)
    }
    length = float(np.linalg.norm(T_p_a[:3, 3]))
    for name, v in zip("xyz", T_p_a[:3, 3] / max(length, 1e-12), strict=True):
        key = f"rig_direction_{name}"
        found[key] = Figure("kit", f"rig, direction to the assistant, {name}", "", float(v))
    return found


def _recording(recording: Recording) -> dict[str, Figure]:
    metadata = recording.metadata
    figures = {
        f"recording_{key}": Figure("recording", key, "", metadata[key])
        for key in ("version", "backbone", "source", "pace")
        if metadata.get(key)
    }
    size = sum(file.stat().st_size for file in recording_files(recording.path)) / 1e6
    figures["size_mb"] = Figure("recording", "size", "MB", size)
    assistant = float(recording.count(IMAGE_TOPICS[Eye.ASSISTANT]))
    figures["frames_assistant"] = Figure("path", "frames of the assistant", "", assistant)
    counts: Mapping[str, Any] = {}
    for status in recording.json_messages(STATUS):
        counts = status if "finished" in status else counts
    for name in COUNTS:
        if name in counts:
            text = name.replace("_", " ")
            figures[name] = Figure("losses", text, "", float(counts[name]))
    return figures
