"""Load an estimate to evaluate from a recording, a map folder or a TUM trajectory."""

from __future__ import annotations

import dataclasses
import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from calm_edge.evaluation import EvaluationError
from calm_edge.trajectories import folded, read_tum
from calm_edge.types import Float, Float32, Int, LocalizerUpdate, Metre, PoseSample
from device.frame import Eye

if TYPE_CHECKING:
    from calm_edge.recording.reader import Recording

# A larger pose age means that publish time and exposure are on different clocks.
MAX_AGE_MS = 60_000.0


@dataclass(frozen=True, slots=True)
class Estimate:
    """A trajectory with its statistics; fields that the source does not contain are None.

    t_ns: (N,). T_w_c: (N, 4, 4) primary camera -> world, world units. spacing_m: None when the
    world is in camera spacings. metre: how well lengths are known. focal_px, focal_sigma_percent:
    one per camera.
    pose_age_ms: {p50, p99} from exposure to publishing. stage_ms: mean per sub-map, by stage.
    points_w: (P, 3) map points, world units. first_frame: (number in the sequence, stamp [ns]),
    which gives the clock offset of a replay. live: poses as published during the drive,
    LOST ones included, sorted by stamp.
    """

    source: str
    t_ns: Int
    T_w_c: Float
    frames: int | None = None
    keyframes: int | None = None
    submaps: int | None = None
    spacing_m: float | None = None
    focal_px: tuple[float, float] | None = None
    focal_sigma_percent: tuple[float | None, float | None] | None = None
    pose_age_ms: dict[str, float] | None = None
    stage_ms: dict[str, float] = field(default_factory=dict)
    points_w: Float32 | None = None
    first_frame: tuple[int, int] | None = None
    live: tuple[PoseSample, ...] = ()
    metre: Metre | None = None

    @property
    def metric(self) -> bool:
        """Whether the world is in metres, as far as is known."""
        return bool(self.spacing_m) and (self.metre is None or self.metre.metric)


def mean_stages(updates: Iterable[LocalizerUpdate]) -> dict[str, float]:
    """Mean milliseconds per sub-map by stage, over the updates that ran the stage."""
    times: dict[str, list[float]] = defaultdict(list)
    for update in updates:
        for stage, ms in update.stage_ms.items():
            times[stage].append(ms)
    return {stage: float(np.mean(values)) for stage, values in times.items()}


def pose_ages(published_ns: Int, exposed_ns: Int) -> dict[str, float] | None:
    """Percentiles {p50, p99} [ms] of the time from exposure to publishing, (N,) ns each.

    None without poses, or if the times are on different clocks, or the same, as in a lockstep run:
    poses are published at the time of their frame.
    """
    ages = (published_ns - exposed_ns) / 1e6
    if len(ages) == 0 or ages.min() < 0 or not 0 < ages.max() <= MAX_AGE_MS:
        return None
    p50, p99 = np.percentile(ages, [50, 99])
    return {"p50": float(p50), "p99": float(p99)}


def from_updates(
    source: str,
    updates: Sequence[LocalizerUpdate],
    frames: int | None = None,
    spacing_m: float | None = None,
    pose_age_ms: dict[str, float] | None = None,
    first_frame: tuple[int, int] | None = None,
) -> Estimate:
    """Estimate from all updates of a run: final trajectory and the last focal lengths.

    spacing_m: 0 or None if not configured. Without updates the estimate has no poses.
    """
    trajectory = folded(update.trajectory for update in updates)
    if trajectory is None:
        return Estimate(
            source,
            np.zeros(0, np.int64),
            np.zeros((0, 4, 4)),
            frames,
            0,
            0,
            spacing_m or None,
            pose_age_ms=pose_age_ms,
        )
    submap = updates[-1].submap
    eyes = (0, submap.n_primary) if submap.assistant_ids else (0, 0)
    sigma = 100 * submap.focal_log_sigma
    return Estimate(
        source,
        trajectory.t_ns,
        trajectory.T_w_c,
        frames,
        len(trajectory.t_ns),
        len({u.submap.id for u in updates}),
        spacing_m or None,
        (submap.cameras[eyes[0]].fx, submap.cameras[eyes[1]].fx),
        (_finite(sigma[0]), _finite(sigma[1])),
        pose_age_ms,
        mean_stages(updates),
        first_frame=first_frame,
        metre=_known(updates[-1].metre),
    )


def _known(metre: Metre) -> Metre | None:
    """The metre of an update, None for one recorded before there was any."""
    return metre if metre.metric or metre.reason else None


def from_tum(path: Path) -> Estimate:
    """Estimate from a TUM trajectory file. Raises EvaluationError."""
    t_ns, T_w_c = read_tum(path)
    return Estimate(str(path), t_ns, T_w_c)


def from_map(folder: Path) -> Estimate:
    """Estimate from a map folder: trajectory.tum, summary.json and, if present, map.ply.

    summary.json: `frames, keyframes, submaps, spacing_m, focal_px, focal_sigma_percent,
    pose_age_ms, stage_ms, first_frame` as in Estimate, `metre` as of `Metre.summary`. Raises
    EvaluationError.
    """
    t_ns, T_w_c = read_tum(folder / "trajectory.tum")
    summary = _summary(folder / "summary.json")
    where = folder / "summary.json"
    cloud = folder / "map.ply"
    first = summary.get("first_frame")
    sigma = _pair(where, summary, "focal_sigma_percent")
    focal = _pair(where, summary, "focal_px")
    return Estimate(
        str(folder),
        t_ns,
        T_w_c,
        summary.get("frames"),
        summary.get("keyframes"),
        summary.get("submaps"),
        _finite(summary.get("spacing_m")) or None,
        (focal[0], focal[1]) if focal and focal[0] and focal[1] else None,
        sigma,
        summary.get("pose_age_ms"),
        summary.get("stage_ms") or {},
        _points(cloud) if cloud.is_file() else None,
        (int(first[0]), int(first[1])) if first else None,
        metre=_metre(where, summary.get("metre")),
    )


def _metre(where: Path, value: Any) -> Metre | None:
    """Metre of its summary; None for a map made before there was any."""
    if value is None:
        return None
    if not isinstance(value, dict):
        raise EvaluationError(f"{where}: metre must hold sigma_percent and reason")
    percent = _finite(value.get("sigma_percent"))
    sigma = np.inf if percent is None else percent / 100
    return _known(Metre(sigma, str(value.get("reason") or "")))


def _summary(path: Path) -> dict[str, Any]:
    try:
        summary = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise EvaluationError(
            f"{path}: not a readable summary ({error}); run calm-edge map again"
        ) from None
    if not isinstance(summary, dict):
        raise EvaluationError(f"{path}: not a JSON object; run calm-edge map again")
    return summary


def _finite(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else None


def _pair(
    where: Path, summary: dict[str, Any], key: str
) -> tuple[float | None, float | None] | None:
    value = summary.get(key)
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise EvaluationError(f"{where}: {key} must hold two numbers, one per camera")
    return _finite(value[0]), _finite(value[1])


def _points(path: Path) -> Float32:
    from calm_edge.mapping.cloud_file import read_cloud

    return read_cloud(path)[0]


def _published_ages(path: Path) -> dict[str, float] | None:
    from calm_edge.recording.scan import scan
    from calm_edge.recording.schema import CLOCK, POSE_SAMPLE
    from calm_edge.recording.segment import segment_files

    published, exposed = [], []
    for file in segment_files(path) if path.is_dir() else [path]:
        index = scan(file)
        if not index.topic_rows(CLOCK):
            # in lockstep nothing is logged at the time of its writing
            continue
        for _, rows in index.topic_rows(POSE_SAMPLE):
            times = [np.array(t, np.int64) for t in (rows.log_time, rows.publish_time)]
            # version 0.1.0 has them the other way round
            written, stamped = times if index.epoch_ns is not None else reversed(times)
            published.append(written)
            exposed.append(stamped)
    return pose_ages(np.concatenate(published), np.concatenate(exposed)) if published else None


def from_recording(path: Path) -> Estimate:
    """Estimate from a recording folder or MCAP file. Raises RecordingError."""
    from calm_edge.recording.reader import Recording

    recording = Recording(path)
    return recorded(recording, list(recording.updates()))


def of_recording(
    source: str, recording: Recording, updates: Sequence[LocalizerUpdate], spacing_m: float | None
) -> Estimate:
    """Estimate of the updates, with frame count and pose age of a recording; without live poses.

    The pose age is the last `pose_age_ms` on the topic /status, else computed from publish time
    and exposure of the logged poses. Raises RecordingError.
    """
    from calm_edge.recording.schema import IMAGE_TOPICS, STATUS

    ages = [s["pose_age_ms"] for s in recording.json_messages(STATUS) if s.get("pose_age_ms")]
    first = next(recording.frames(Eye.PRIMARY), None)
    return from_updates(
        source,
        updates,
        recording.count(IMAGE_TOPICS[Eye.PRIMARY]),
        spacing_m,
        ages[-1] if ages else _published_ages(recording.path),
        (first.sequence, first.t_ns) if first else None,
    )


def recorded(recording: Recording, updates: Sequence[LocalizerUpdate]) -> Estimate:
    """Estimate from a recording and its updates. Raises RecordingError."""
    from calm_edge.recording.schema import STATUS

    path = recording.path
    estimate = of_recording(str(path), recording, updates, recording.config.scale.spacing_m)
    live = tuple(sorted(recording.poses(), key=lambda sample: sample.t_ns))
    metre = estimate.metre
    if not estimate.submaps:
        # without a sub-map only the result of `record` says why
        for status in recording.json_messages(STATUS):
            metre = _metre(path, status.get("metre")) or metre
    return dataclasses.replace(estimate, live=live, metre=metre)


def read_estimate(target: Path) -> Estimate:
    """Estimate from a recording (folder or .mcap), a map folder or a TUM file.

    Raises EvaluationError or RecordingError.
    """
    target = Path(target)
    if not target.exists():
        raise EvaluationError(f"{target}: not found; give a recording, a map folder or a TUM file")
    if target.is_dir():
        if (target / "trajectory.tum").is_file():
            return from_map(target)
        return from_recording(target)
    return from_recording(target) if target.suffix in {".mcap", ".part"} else from_tum(target)
