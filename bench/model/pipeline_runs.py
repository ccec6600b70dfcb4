"""Runs of whole drives by bundle with and without the network."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench import pixel_cases, steps, targets
from bench.drives import Prepare
from bench.model.ours import MODEL
from bench.perturb import Perturbation, perturbed
from bench.pixel_targets import error_m
from calm_edge.evaluation import EvaluationError
from calm_edge.recording.reader import Recording
from calm_edge.types import CalmEdgeError, LocalizerUpdate

RESULTS = "model_pipeline.json"
# Name of the stage that computes depth. It is skipped when there is no time for it.
DEPTH_STAGE = "densify"
# Share of frames dropped at seeds other than 0; the solver's seed alone does not vary the result.
LOST = 0.05


@dataclass(frozen=True, slots=True)
class Variant:
    """A configuration for `record`: SECTION.KEY=VALUE settings, and its option --pace."""

    name: str
    settings: tuple[str, ...]
    pace: str = "lockstep"

    def options(self, seed: int) -> tuple[str, ...]:
        """Options of `record` for this variant. seed: of the backbone."""
        settings = (*self.settings, f"backbone.seed={seed}")
        return ("--pace", self.pace, *(part for s in settings for part in ("--set", s)))


PLAIN = Variant("bundle", ("backbone.name=bundle",))
_WITH = f"backbone.name=bundle:{MODEL}"
NETWORK = Variant(f"bundle:{MODEL}", (_WITH, "backbone.precision=fp32"))
INT8 = Variant(f"bundle:{MODEL} int8", (_WITH, "backbone.precision=int8"))
# The precision is the one that `model check` chose for this machine, as for a user.
TIMED = (
    Variant("bundle, real time", PLAIN.settings, "realtime"),
    Variant(f"bundle:{MODEL}, real time", (_WITH,), "realtime"),
)


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive to record.

    options: of `record`. error: key of the drive's error in `eval --json`.
    """

    name: str
    prepare: Prepare
    options: tuple[str, ...]
    error: str = "ate_se3_m"


_REAL = ("karlsruhe", "karlsruhe_late", "kitti06")


def _drives() -> dict[str, Drive]:
    """Drives of the benches `targets` and `pixels`, by name.

    A drive that both have is taken from `targets`.
    """
    found = {}
    for case in (*pixel_cases.UNSEEN, *pixel_cases.CASES):
        error = "ate_sim3_m" if case.name in _REAL else "ate_se3_m"
        options = ("--spacing-m", f"{case.spacing_m:g}")
        found[case.name] = Drive(case.name, case.loose, options, error)
    for row in targets.ROWS:
        if not row.twice:
            # the scale of the real clips is inexact or unknown
            error = "ate_sim3_m" if row.name in _REAL else "ate_se3_m"
            found[row.name] = Drive(row.name, row.prepare, row.options, error)
    return found


DRIVES = _drives()
SHORT = ("karlsruhe", "kitti06", "aalborg", "demo")
HELD_OUT = tuple(case.name for case in pixel_cases.UNSEEN)
ALL = tuple(name for name in DRIVES if name not in HELD_OUT)

# {drive: {variant: {seed: figures}}}
Results = dict[str, dict[str, dict[str, dict[str, Any]]]]


def full_windows_s(updates: Iterable[LocalizerUpdate], most: int) -> list[dict[str, float]]:
    """Seconds by stage of each full window when it was first solved.

    most: number of keyframes of each eye in a full window. The first full window is left out, since
    it overlaps with no earlier one.
    """
    found: dict[int, dict[str, float]] = {}
    for update in updates:
        submap = update.submap
        if submap.n_primary == len(submap.assistant_ids) == most:
            found.setdefault(submap.id, {k: ms / 1e3 for k, ms in update.stage_ms.items()})
    return list(found.values())[1:]


def run(drive: Drive, variant: Variant, seed: int, out: Path) -> dict[str, Any]:
    """Record and evaluate one drive: `error_m` (None if the drive was lost) and `windows_s`.

    Seed 0 replays the whole drive; other seeds drop a share LOST of each eye's frames at random. If
    there are no figures the reason is under `skipped` or `failed`.
    """
    work = out / "model_pipeline" / drive.name / variant.name.replace(":", "_")
    work.mkdir(parents=True, exist_ok=True)
    sequence = drive.prepare(work)
    if isinstance(sequence, str):
        return {"skipped": sequence}
    if seed:
        sequence = perturbed(sequence, work / "thinned", Perturbation(drop=(LOST, LOST), seed=seed))
    recording = work / "recording"
    try:
        cost = steps.record(sequence, recording, (*drive.options, *variant.options(seed)))
        figures = steps.figures(recording, sequence)
        kept = Recording(recording)
        windows = full_windows_s(kept.updates(), kept.config.frontend.n_max)
    except CalmEdgeError as failure:
        return {"failed": str(failure)}
    error = error_m(figures, drive.error)
    return {
        "error_m": error if math.isfinite(error) else None,
        "windows_s": windows,
        "cpu_s": cost.cpu_s,
        "wall_s": cost.wall_s,
    }


def read_results(file: Path) -> Results:
    """Read the results of earlier runs, empty if there are none; raises EvaluationError."""
    if not file.is_file():
        return {}
    try:
        found: Results = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise EvaluationError(f"{file}: not readable ({error}); remove it") from None
    return found


def run_all(drives: Sequence[Drive], variants: Sequence[Variant], seeds: int, out: Path) -> Results:
    """Run all variants on each drive and seed, writing each result to disk at once."""
    out.mkdir(parents=True, exist_ok=True)
    results = read_results(out / RESULTS)
    for drive in drives:
        for seed in range(seeds):
            for variant in variants:
                print(f"{drive.name}, {variant.name}, seed {seed} ...", file=sys.stderr, flush=True)
                figures = run(drive, variant, seed, out)
                results.setdefault(drive.name, {}).setdefault(variant.name, {})[str(seed)] = figures
                (out / RESULTS).write_text(json.dumps(results, indent=1, allow_nan=False) + "\n")
    return results


def errors(results: Mapping[str, Any], variant: Variant) -> dict[tuple[str, int], float | None]:
    """Errors by (drive, seed), None after a failure; skipped runs are left out."""
    return {
        (drive, int(seed)): figures.get("error_m")
        for drive, variants in results.items()
        for seed, figures in variants.get(variant.name, {}).items()
        if "skipped" not in figures
    }
