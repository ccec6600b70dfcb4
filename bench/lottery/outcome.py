"""Record and evaluate a drive with the code of a git checkout; the outcome is kept in a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench import steps
from bench.drives import ROOT
from bench.lottery.draw import Drawn
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.trajectory import associate, path_length
from calm_edge.evaluation.truth import read_truth
from calm_edge.geometry import se3
from calm_edge.recording.reader import Recording
from calm_edge.recording.retention import TRAJECTORY_FILE
from calm_edge.trajectories import read_tum
from calm_edge.types import Float

FOLDER = ROOT / "build" / "lottery"
# A step, the distance between consecutive keyframes, is garbage if the log of its ratio to the true
# one differs by more than this from the median over the drive.
GARBAGE_LOG = 0.18
# With a shorter true step the car counts as standing, and the step is not judged, m.
STANDING_M = 0.02


@dataclass(frozen=True, slots=True)
class Outcome:
    """Figures of one drive, None where there is no result.

    path_m: length of the true path. yaw_deg: magnitude of the sum of its turns. ate_percent: ATE
    after rigid alignment, percent of the path. scale: of the similarity that best aligns trajectory
    and truth, 1 if the trajectory is exact. placed: share of the primary keyframes with a pose.
    garbage: share of the steps between these that are wrong by more than GARBAGE_LOG. focal_error,
    focal_sigma: of the log focal, one per eye. failed: reason why there is no result, else empty.
    """

    drive: str
    path_m: float
    yaw_deg: float
    ate_percent: float | None = None
    scale: float | None = None
    placed: float = 0.0
    garbage: float = 1.0
    focal_error: tuple[float, float] | None = None
    focal_sigma: tuple[float, float] | None = None
    failed: str = ""


def code_key(checkout: Path) -> str:
    """Hash of the shipped code, models and settings in a checkout."""
    digest = hashlib.sha256()
    for folder in ("calm_edge", "device"):
        for file in sorted((checkout / folder).rglob("*")):
            if file.suffix in {".py", ".onnx", ".toml"}:
                digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def outcome(drawn: Drawn, checkout: Path) -> Outcome:
    """Outcome of a drive, computed once for each code_key; raises EvaluationError."""
    kept = FOLDER / code_key(checkout) / f"{drawn.name}.json"
    if kept.is_file():
        values: dict[str, Any] = json.loads(kept.read_text())
        pairs = {k: tuple(v) for k, v in values.items() if isinstance(v, list)}
        return Outcome(**values | pairs)
    sequence = drawn.prepare(FOLDER)
    if isinstance(sequence, str):
        raise EvaluationError(f"{drawn.name}: {sequence}")
    found = _measured(drawn, checkout, sequence, kept.parent / drawn.name)
    part = kept.with_suffix(".part")
    part.write_text(json.dumps(asdict(found)))
    part.rename(kept)
    return found


def _measured(drawn: Drawn, checkout: Path, sequence: Path, work: Path) -> Outcome:
    truth = read_truth(sequence)
    turns = se3.so3_log(se3.inverse(truth.T_w_c[:-1])[:, :3, :3] @ truth.T_w_c[1:, :3, :3])
    path_m = path_length(truth.T_w_c[:, :3, 3])
    yaw_deg = float(np.degrees(np.abs(turns[:, 1].sum())))
    recording, options = work / "recording", ("--spacing-m", f"{drawn.spacing_m:g}")
    work.mkdir(parents=True, exist_ok=True)
    try:
        steps.record(sequence, recording, options, checkout)
        figures = steps.figures(recording, sequence, checkout)
        if figures["ate_se3_m"] is None:
            raise EvaluationError("no keyframe was placed")
    except EvaluationError as error:
        return Outcome(drawn.name, path_m, yaw_deg, failed=str(error))
    focals, sigmas = figures["focal_px"], figures["focal_sigma_percent"]
    errors, sigma = None, None
    if focals is not None and sigmas is not None and truth.cameras is not None:
        errors = _pair(np.log(f / c.fx) for f, c in zip(focals, truth.cameras, strict=True))
        sigma = _pair(np.inf if s is None else s / 100 for s in sigmas)
    placed, garbage = _steps(recording, truth.t_ns, truth.T_w_c)
    return Outcome(
        drawn.name,
        path_m,
        yaw_deg,
        100 * figures["ate_se3_m"] / path_m,
        figures["sim3_scale"],
        placed,
        garbage,
        errors,
        sigma,
    )


def _pair(values: Iterable[float]) -> tuple[float, float]:
    primary, assistant = values
    return float(primary), float(assistant)


def _steps(recording: Path, t_truth: Any, T_truth: Float) -> tuple[float, float]:
    """Share of the primary keyframes with a pose, and of garbage among the steps between them."""
    windows = list(Recording(recording).windows())
    keyframes = {int(i) for w in windows for i, eye in zip(w.ids, w.eyes, strict=True) if eye == 0}
    t_ns, T_w_c = read_tum(recording / TRAJECTORY_FILE)
    i, j = associate(t_ns, t_truth)
    step = np.linalg.norm(np.diff(T_w_c[i, :3, 3], axis=0), axis=1)
    true = np.linalg.norm(np.diff(T_truth[j, :3, 3], axis=0), axis=1)
    return len(t_ns) / max(len(keyframes), 1), garbage_share(step, true)


def garbage_share(step: Float, true: Float) -> float:
    """Share of garbage (GARBAGE_LOG) among steps (N,), those where the car stands left out.

    step, true: estimated and true distances between consecutive keyframes, m.
    """
    moving = true > STANDING_M
    ratio = np.log(np.maximum(step[moving], 1e-9) / true[moving])
    return float((np.abs(ratio - np.median(ratio)) > GARBAGE_LOG).mean())
