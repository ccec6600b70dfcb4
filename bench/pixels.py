"""Compare calm-edge with ORB-SLAM3, COLMAP and both chaining baselines, on pictures.

calm-edge gets the drive with unsynchronised cameras and the camera spacing, nothing else. Sim(3)
and SL(4) chaining get the sub-maps of that run. ORB-SLAM3 gets the same drive synchronised and the
true calibration, then the same with one parameter wrong. COLMAP, on request, gets the pictures
alone. Results are kept in build/eval/pixels.json by drive and method; a run of some replaces only
their results.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from bench import steps
from bench.chained import chained
from bench.drives import Prepare
from bench.pixel_cases import CASES, EVERY, UNSEEN, WORSE, Case
from bench.pixel_targets import Verdict, verdicts
from bench.rivals import colmap, orbslam3
from bench.rivals.calibration import Calibration, true_calibration
from bench.rivals.environment import RivalMissing, RivalRun
from bench.tables import Check, Table, publish
from bench.targets import OUT
from calm_edge.evaluation.estimate import Estimate
from calm_edge.evaluation.results import compare
from calm_edge.evaluation.truth import read_truth
from calm_edge.types import CalmEdgeError

FOCAL_WRONG = 1.02
YAW_WRONG_DEG = 0.5

_KEPT = (
    "poses",
    "path_m",
    "coverage_percent",
    "ate_se3_m",
    "ate_sim3_m",
    "sim3_scale",
    "focal_px",
    "focal_sigma_percent",
    "focal_error_percent",
)


# Maps a drive and a work folder to the figures of one method.
Method = Callable[[Case, Path], dict[str, Any]]


def _prepared(prepare: Prepare, out: Path) -> Path:
    folder = prepare(out)
    if isinstance(folder, str):
        raise RivalMissing(folder)
    return folder


def ours(case: Case, out: Path) -> dict[str, Any]:
    """Record with calm-edge in lockstep, given the spacing, and evaluate."""
    sequence = _prepared(case.loose, out)
    recording = out / "recording"
    cost = steps.record(sequence, recording, ("--spacing-m", f"{case.spacing_m:g}"))
    result = steps.figures(recording, sequence)
    figures = {key: result[key] for key in _KEPT}
    return {**figures, "cpu_s": cost.cpu_s, "wall_s": cost.wall_s}


def judged(run: RivalRun, folder: Path) -> dict[str, Any]:
    """Figures of a rival's run: errors of its positions, and the share of frames with a pose."""
    truth = read_truth(folder)
    placed = len(run.t_ns) / max(run.frames, 1)
    figures: dict[str, Any] = {"placed": placed, "cpu_s": run.cpu_s, "wall_s": run.wall_s}
    if len(run.t_ns) >= 3:
        result = compare(Estimate("rival", run.t_ns, run.T_w_c), truth)
        figures |= {key: result[key] for key in _KEPT[:6]}
    if run.focal_px:
        figures["focal_px"] = list(run.focal_px)
    return figures


def _orbslam3(
    altered: Callable[[Calibration], Calibration] = lambda truth: truth,
    shift: int = 0,
    loose: bool = False,
) -> Method:
    def method(case: Case, out: Path) -> dict[str, Any]:
        in_step = _prepared(case.in_step, out)
        folder = _prepared(case.loose, out) if loose else in_step
        if loose and folder == in_step:
            raise RivalMissing("this drive has no clock faults")
        # from the synchronised drive, where both eyes have poses at the same times
        truth = true_calibration(in_step, case.spacing_m)
        return judged(orbslam3.run(folder, altered(truth), out, shift), folder)

    return method


def _colmap(case: Case, out: Path) -> dict[str, Any]:
    folder = _prepared(case.loose, out)
    return judged(colmap.run(folder, out), folder)


def _chained(alignment: str) -> Method:
    def method(case: Case, out: Path) -> dict[str, Any]:
        sequence, recording = _prepared(case.loose, out), out.parent / "ours" / "recording"
        if not recording.is_dir():
            raise RivalMissing("no recording of our method; run --method ours first")
        result = compare(chained(recording, alignment), read_truth(sequence), "se3")
        return {key: result[key] for key in _KEPT[:6]}

    return method


METHODS: dict[str, Method] = {
    "ours": ours,
    "sim3": _chained("sim3"),
    "sl4": _chained("sl4"),
    "orbslam3": _orbslam3(),
    "orbslam3_focal": _orbslam3(lambda c: c.with_focal(FOCAL_WRONG)),
    "orbslam3_yaw": _orbslam3(lambda c: c.with_yaw(YAW_WRONG_DEG)),
    "orbslam3_frame": _orbslam3(shift=1),
    "orbslam3_loose": _orbslam3(loose=True),
    "colmap": _colmap,
}
# Methods that take minutes of CPU for a few dozen pictures: run only if named.
EXPENSIVE = frozenset({"colmap"})


def measure(case: Case, method: str, out: Path) -> dict[str, Any]:
    """Run one method on one drive; return figures, or the reason under `skipped` or `failed`."""
    work = out / case.name / method
    work.mkdir(parents=True, exist_ok=True)
    try:
        return METHODS[method](case, work)
    except RivalMissing as error:
        return {"skipped": str(error)}
    except CalmEdgeError as error:
        return {"failed": str(error)}


def read_results(path: Path) -> dict[str, dict[str, Any]]:
    """Read {drive: {method: figures}} of earlier runs; empty if there are none."""
    if not path.is_file():
        return {}
    found = json.loads(path.read_text()).get("drives", {})
    assert isinstance(found, dict)
    return found


def table(results: Mapping[str, Mapping[str, Any]]) -> list[list[Any]]:
    """Table rows: drive, method, SE(3) m, % of path, Sim(3) m, placed, CPU s, note."""
    rows: list[list[Any]] = []
    for name, methods in results.items():
        for method in METHODS:
            if method not in methods:
                continue
            figures = methods[method]
            error, path = figures.get("ate_se3_m"), figures.get("path_m")
            part = None if error is None or not path else 100 * error / path
            placed = figures.get("placed")
            covered = 100 * placed if placed is not None else figures.get("coverage_percent")
            note = figures.get("failed") or figures.get("skipped") or ""
            sim3, cpu = figures.get("ate_sim3_m"), figures.get("cpu_s")
            rows.append([name, method, error, part, sim3, covered, cpu, note])
    return rows


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--only", action="append", metavar="NAME", choices=list(EVERY))
    parser.add_argument("--method", action="append", choices=list(METHODS))
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--held-out", action="store_true", help="the tracks nothing is tuned on")
    group.add_argument(
        "--worse", action="store_true", help="stamp errors, shifted principal points"
    )
    parser.add_argument("--show", action="store_true", help="show the kept results alone")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Run methods on drives, print and save the table; return 1 if a target is missed."""
    cases = UNSEEN if options.held_out else WORSE if options.worse else CASES
    names = options.only or [case.name for case in cases]
    methods = options.method or [m for m in METHODS if m not in EXPENSIVE]
    file = options.out / "pixels.json"
    options.out.mkdir(parents=True, exist_ok=True)
    results = read_results(file)
    for name in () if options.show else names:
        for method in methods:
            print(f"{name} {method} ...", file=sys.stderr, flush=True)
            results.setdefault(name, {})[method] = measure(
                EVERY[name], method, options.out / "pixels"
            )
            keep(file, results)
    checks = keep(file, results)
    return publish(as_table(results, checks), options.out)


def as_table(results: Mapping[str, Mapping[str, Any]], checks: Sequence[Verdict]) -> Table:
    """Make the table of all figures, with the targets that could be evaluated."""
    unjudged = "; ".join(what for what, _, _, passed in checks if passed is None)
    return Table(
        name="40_pixels",
        title="Pictures: ours beside the rivals",
        command="python -m bench pixels",
        columns=(
            "drive",
            "method",
            "SE(3) m",
            "% of path",
            "Sim(3) m",
            "placed %",
            "CPU s",
            "note",
        ),
        rows=tuple(tuple(row) for row in table(results)),
        checks=tuple(Check(w, a, m, p) for w, a, m, p in checks if p is not None),
        notes=(f"not measured yet: {unjudged}",) if unjudged else (),
    )


def keep(file: Path, results: Mapping[str, Mapping[str, Any]]) -> list[Verdict]:
    """Write the results and targets to `file` as {drives, targets}; return the verdicts."""
    checks = verdicts(results, {case.name for case in EVERY.values() if case.counts})
    keys = ("what", "asked", "measured", "passed")
    content = {"drives": results, "targets": [dict(zip(keys, c, strict=True)) for c in checks]}
    file.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
    return checks
