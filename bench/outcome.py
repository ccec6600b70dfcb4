"""Record and evaluate a drive with the code of a git checkout; the outcome is kept in a file.

The recording is kept as well, and made once for each state of that code.
"""

from __future__ import annotations

import hashlib
import json
import math
import shutil
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from bench import claimed, graph_covariance, keyframe_steps, relative_poses, steps
from bench.drives import ROOT, Prepare
from bench.relative_poses import Common, Stretches
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.results import MAX_FOCAL_SIGMA_PERCENT
from calm_edge.evaluation.truth import Truth, read_truth
from calm_edge.geometry import se3
from calm_edge.geometry.polyline import path_length
from calm_edge.offline.submaps import gather
from calm_edge.recording.reader import Recording
from calm_edge.recording.retention import TRAJECTORY_FILE
from calm_edge.types import CalmEdgeError, Float

FOLDER = ROOT / "build" / "outcomes"
Pair = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Trial:
    """A drive to record. prepare: returns its sequence folder. options: of `record`."""

    name: str
    prepare: Prepare
    options: tuple[str, ...]


def trial(name: str, prepare: Prepare, spacing_m: float, *options: str) -> Trial:
    """Trial of a drive whose camera spacing is given to `record`."""
    return Trial(name, prepare, ("--spacing-m", f"{spacing_m:g}", *options))


@dataclass(frozen=True, slots=True)
class Outcome:
    """Figures of one drive, None where there is no result.

    path_m: length of the true path. yaw_deg: range of its heading. ate_percent: ATE after rigid
    alignment, percent of the path. sim3_m: ATE after alignment by a similarity. scale: of that
    similarity, which takes the trajectory to the truth: 1 if the trajectory is exact. scale_sigma:
    claimed sigma of its log, inf if nothing determined it; None if no sigma is reported. placed,
    garbage, metric, garbage_of_metric: as in `keyframe_steps.Steps`. focal_error, focal_sigma: of
    the log focal, one per eye; an unknown sigma is inf. live, final: errors of relative poses by
    length. failed: reason why there is no result, else empty.
    """

    drive: str
    path_m: float
    yaw_deg: float
    ate_percent: float | None = None
    sim3_m: float | None = None
    scale: float | None = None
    scale_sigma: float | None = None
    placed: float = 0.0
    garbage: float = 1.0
    focal_error: Pair | None = None
    focal_sigma: Pair | None = None
    live: Mapping[str, Stretches] = field(default_factory=dict)
    final: Mapping[str, Stretches] = field(default_factory=dict)
    failed: str = ""
    metric: float = 0.0
    garbage_of_metric: float = 0.0

    @property
    def observed(self) -> tuple[bool, bool]:
        """Whether each focal is called observed."""
        primary, assistant = self.focal_sigma or (math.inf, math.inf)
        most = MAX_FOCAL_SIGMA_PERCENT / 100
        return primary <= most, assistant <= most

    @property
    def scale_error(self) -> float | None:
        """Error of the log scale, positive for a path that is too long."""
        return None if self.scale is None else -math.log(self.scale)

    def to_json(self) -> dict[str, Any]:
        stretches = {
            key: {name: s.to_json() for name, s in getattr(self, key).items()}
            for key in ("live", "final")
        }
        return asdict(self) | stretches

    @classmethod
    def of_json(cls, values: dict[str, Any]) -> Outcome:
        for key in ("focal_error", "focal_sigma"):
            values[key] = None if values[key] is None else tuple(values[key])
        for key in ("live", "final"):
            values[key] = {name: Stretches.of_json(s) for name, s in values[key].items()}
        return cls(**values)


def code_key(checkout: Path) -> str:
    """Hash of the shipped code, models and settings in a checkout."""
    digest = hashlib.sha256()
    for folder in ("calm_edge", "device"):
        for file in sorted((checkout / folder).rglob("*")):
            if file.suffix in {".py", ".onnx", ".toml"}:
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


@cache
def measure_key() -> str:
    """Hash of the code that measures: a change of it measures the kept recordings again."""
    modules = (claimed, graph_covariance, keyframe_steps, relative_poses)
    return files_key([Path(__file__), *(Path(module.__file__ or "") for module in modules)])


def files_key(files: Iterable[Path]) -> str:
    """Hash of the contents of some files."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in sorted(files))).hexdigest()[:8]


def outcomes(trials: Iterable[Trial], checkout: Path) -> list[Outcome]:
    """Outcomes of several drives, each printed to stderr when it is there."""
    found = []
    for one in trials:
        found.append(outcome(one, checkout))
        _note(f"{checkout}: {progress(found[-1])}")
    return found


def progress(one: Outcome) -> str:
    """One line on a drive."""
    if one.ate_percent is None:
        return f"{one.drive}: {one.failed}"
    return f"{one.drive}: ATE {one.ate_percent:.2f} %, garbage {100 * one.garbage:.1f} %"


def recording_of(drive: Trial, checkout: Path) -> Path:
    """Folder in which the recording of a drive is kept."""
    return FOLDER / code_key(checkout) / drive.name / "recording"


def outcome(drive: Trial, checkout: Path) -> Outcome:
    """Outcome of a drive, computed once for each code_key and measure_key.

    Raises EvaluationError.
    """
    recording = recording_of(drive, checkout)
    work = recording.parent
    kept = work.parent / f"{drive.name}.{measure_key()}.json"
    if kept.is_file():
        return Outcome.of_json(json.loads(kept.read_text()))
    work.mkdir(parents=True, exist_ok=True)
    sequence = drive.prepare(work)
    if isinstance(sequence, str):
        raise EvaluationError(f"{drive.name}: {sequence}")
    found = _measured(drive, checkout, sequence, recording)
    check_unchanged(checkout, work)
    part = kept.with_suffix(".part")
    part.write_text(json.dumps(found.to_json()))
    part.rename(kept)
    return found


def check_unchanged(checkout: Path, work: Path) -> None:
    """Remove `work` and raise EvaluationError if the code is no longer that of the work's key."""
    if code_key(checkout) != work.parent.name:
        shutil.rmtree(work)
        raise EvaluationError(f"{checkout}: its code changed while {work.name} was recorded")


def heading_range_deg(T_w_c: Float) -> float:
    """Range of the heading along poses (N, 4, 4), degrees: what a focal can be learned from."""
    turns = se3.so3_log(se3.inverse(T_w_c[:-1])[:, :3, :3] @ T_w_c[1:, :3, :3])
    heading = np.concatenate([[0.0], np.cumsum(turns[:, 1])])
    return float(np.degrees(np.ptp(heading)))


def _measured(drive: Trial, checkout: Path, sequence: Path, recording: Path) -> Outcome:
    truth = read_truth(sequence)
    path_m = path_length(truth.T_w_c[:, :3, 3])
    yaw_deg = heading_range_deg(truth.T_w_c)
    try:
        if not (recording / TRAJECTORY_FILE).is_file():
            steps.record(sequence, recording, drive.options, checkout)
        figures = steps.figures(recording, sequence, checkout)
        if figures["ate_se3_m"] is None:
            raise EvaluationError("no keyframe was placed")
        judged = keyframe_steps.judged(recording, truth)
    except CalmEdgeError as error:
        return Outcome(drive.name, path_m, yaw_deg, failed=str(error))
    updates = list(Recording(recording).updates())
    scale_sigma = claimed.scale_sigma(updates)
    focal_error, focal_sigma = _focals(figures, truth)
    focal = focal_sigma[0] if focal_sigma else None
    common = Common(scale_sigma, focal, claimed.axes_sigma(updates))
    live, final = _relative(recording, truth, common)
    return Outcome(
        drive.name,
        path_m,
        yaw_deg,
        100 * figures["ate_se3_m"] / path_m,
        figures["ate_sim3_m"],
        figures["sim3_scale"],
        scale_sigma,
        judged.placed,
        judged.garbage,
        focal_error,
        focal_sigma,
        live,
        final,
        metric=judged.metric,
        garbage_of_metric=judged.garbage_of_metric,
    )


def _focals(figures: Mapping[str, Any], truth: Truth) -> tuple[Pair | None, Pair | None]:
    focals, sigmas = figures["focal_px"], figures["focal_sigma_percent"]
    if focals is None or sigmas is None or truth.cameras is None:
        return None, None
    errors = _pair(np.log(f / c.fx) for f, c in zip(focals, truth.cameras, strict=True))
    return errors, _pair(np.inf if s is None else s / 100 for s in sigmas)


def _relative(
    recording: Path, truth: Truth, common: Common
) -> tuple[dict[str, Stretches], dict[str, Stretches]]:
    """Stretches of the live poses and of the final ones."""
    source = Recording(recording)
    samples = sorted(source.poses(), key=lambda sample: sample.t_ns)
    live = relative_poses.of_live(samples, truth, with_scale=common.scale is not None)
    try:
        config = source.config
        drive = gather(source, config, _note)
    except CalmEdgeError as error:
        # another version may know settings that this one does not
        _note(f"{recording}: no covariances of the final poses: {error}")
        return live, {}
    return live, relative_poses.of_final(drive, config, truth, common)


def _note(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _pair(values: Iterable[float]) -> Pair:
    primary, assistant = values
    return float(primary), float(assistant)
