"""What calm-edge promises, and its measuring: `python -m calm_edge.evaluation.targets`.

Every row is run the way a user would: `calm-edge record --sequence` in lockstep, `calm-edge map`,
`calm-edge eval --json`, each a process of its own. Truth and calibration are seen by `eval` alone.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from calm_edge.evaluation.drives import DATA, ROOT, Prepare, late_assistant, simulated, there
from calm_edge.evaluation.estimate import read_estimate
from calm_edge.evaluation.results import MAX_FOCAL_SIGMA_PERCENT
from calm_edge.evaluation.table import print_rows
from calm_edge.evaluation.trajectory_file import tum_text
from calm_edge.types import CalmEdgeError

OUT = ROOT / "build" / "eval"


class TargetError(CalmEdgeError):
    """A step of a row failed."""


@dataclass(frozen=True, slots=True)
class Metric:
    """One promise. key: of `eval --json`; a list is held to its worst entry by size.

    most: the largest that passes. least: what every entry must exceed, null counting as
    endless (a sigma). may_be_null: null entries pass, as nothing was claimed.
    """

    key: str
    asked: str
    most: float | None = None
    least: float | None = None
    may_be_null: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One drive. prepare: its sequence folder, or why there is none. options: of `record`.

    twice: record it again and compare the trajectories' bytes.
    """

    name: str
    prepare: Prepare
    options: tuple[str, ...] = ()
    metrics: tuple[Metric, ...] = ()
    twice: bool = False


@dataclass(frozen=True, slots=True)
class Measured:
    """What came of a row. checks: (what, asked, measured, passed). skipped: why it was not run."""

    name: str
    checks: tuple[tuple[str, str, Any, bool], ...] = ()
    result: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    skipped: str = ""


KARLSRUHE, KITTI06 = DATA / "karlsruhe_town", DATA / "kitti06_straight"
AALBORG = ("--track", "aalborg", "--frames", "600")
FOCAL = Metric("focal_error_percent", "within 5 %", 5.0)
HONEST = Metric("focal_error_in_sigma", "<= 3 sigma", 3.0, may_be_null=True)

ROWS = (
    Row(
        "karlsruhe",
        there(KARLSRUHE),
        ("--spacing-m", "0.5712"),
        (Metric("ate_sim3_m", "<= 1.0 m", 1.0), FOCAL, HONEST),
    ),
    Row(
        "karlsruhe_late",
        late_assistant(KARLSRUHE),
        ("--spacing-m", "0.5712"),
        (Metric("ate_sim3_m", "<= 1.2 m", 1.2), HONEST),
    ),
    Row(
        "kitti06",
        there(KITTI06),
        (),
        (
            Metric("ate_sim3_m", "<= 0.2 m", 0.2),
            Metric("focal_sigma_percent", "unobserved: > 5 %", least=MAX_FOCAL_SIGMA_PERCENT),
        ),
    ),
    Row(
        "kitti06_hint",
        there(KITTI06),
        ("--hfov-deg", "82", "--spacing-m", "0.5372"),
        (Metric("ate_se3_m", "<= 0.6 m", 0.6), HONEST),
    ),
    Row(
        "aalborg",
        simulated("aalborg", *AALBORG),
        ("--spacing-m", "0.55"),
        (Metric("ate_percent", "<= 1 % of path", 1.0), HONEST),
    ),
    Row(
        "aalborg_async",
        simulated("aalborg_async", *AALBORG, "--async", "0.03"),
        ("--spacing-m", "0.55"),
        (Metric("ate_percent", "<= 1.2 % of path", 1.2), HONEST),
    ),
    Row(
        "demo",
        there(ROOT / "demo" / "drive"),
        ("--spacing-m", "0.5"),
        (
            Metric("ate_percent", "<= 0.5 % of path", 0.5),
            Metric("map_chamfer_m", "<= 0.6 m", 0.6),
            HONEST,
        ),
    ),
    Row("determinism", there(KITTI06), ("--spacing-m", "0.5372"), (), twice=True),
)


def judge(metric: Metric, result: Mapping[str, Any]) -> tuple[Any, bool]:
    """(what was measured, whether it passes); raises TargetError when the key is missing."""
    if metric.key not in result:
        raise TargetError(f"eval --json has no {metric.key}")
    value = result[metric.key]
    entries = value if isinstance(value, list) else [value]
    known = [abs(entry) for entry in entries if entry is not None]
    whole = metric.may_be_null or len(known) == len(entries)
    if metric.least is not None:
        return value, value is not None and all(entry > metric.least for entry in known)
    return value, whole and all(entry <= metric.most for entry in known if metric.most is not None)


def with_honesty(result: dict[str, Any]) -> dict[str, Any]:
    """The result and `focal_error_in_sigma`, an eye; None where the focal is unobserved."""
    errors, sigmas = result.get("focal_error_percent"), result.get("focal_sigma_percent")
    ratio = [
        abs(e) / s if e is not None and s else None
        for e, s in zip(errors or (), sigmas or (), strict=True)
    ]
    return {**result, "focal_error_in_sigma": ratio}


def _calm_edge(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "calm_edge.cli", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines() or ["it said nothing"]
        raise TargetError(f"calm-edge {arguments[0]}: exit {done.returncode}: {said[-1]}")
    return done.stdout


def _record(sequence: Path, out: Path, options: tuple[str, ...]) -> Path:
    shutil.rmtree(out, ignore_errors=True)
    sequence_options = ("--sequence", str(sequence), "--out", str(out), "--pace", "lockstep")
    _calm_edge("record", *sequence_options, *options)
    return out


def _trajectory(recording: Path) -> str:
    estimate = read_estimate(recording)
    return tum_text(estimate.t_ns, estimate.T_w_c)


def run_row(row: Row, out: Path) -> Measured:
    """Record, map and evaluate one row under `out`; raises TargetError when a step fails."""
    out.mkdir(parents=True, exist_ok=True)
    sequence = row.prepare(out)
    if isinstance(sequence, str):
        return Measured(row.name, skipped=sequence)
    seconds: dict[str, float] = {}

    def timed(step: str, work: Callable[[], Any]) -> Any:
        start = time.monotonic()
        value = work()
        seconds[step] = round(time.monotonic() - start, 1)
        return value

    recording = timed("record", lambda: _record(sequence, out / "recording", row.options))
    if row.twice:
        again = timed("record again", lambda: _record(sequence, out / "again", row.options))
        first, second = _trajectory(recording), _trajectory(again)
        same = bool(first) and first == second
        check = ("trajectory bytes", "identical", "identical" if same else "different", same)
        return Measured(row.name, (check,), {}, seconds)
    made = out / "map"
    shutil.rmtree(made, ignore_errors=True)
    timed("map", lambda: _calm_edge("map", str(recording), "--out", str(made)))
    text = timed("eval", lambda: _calm_edge("eval", str(made), "--truth", str(sequence), "--json"))
    result = with_honesty(json.loads(text))
    checks = tuple((m.key, m.asked, *judge(m, result)) for m in row.metrics)
    return Measured(row.name, checks, result, seconds)


def _plain(measured: Measured) -> dict[str, Any]:
    keys = ("what", "asked", "measured", "passed")
    return {
        "name": measured.name,
        "checks": [dict(zip(keys, check, strict=True)) for check in measured.checks],
        "result": dict(measured.result),
        "seconds": dict(measured.seconds),
        "skipped": measured.skipped,
    }


def main(argv: list[str] | None = None) -> int:
    """Run the rows, print asked against measured, write report.json; 1 when a promise is broken."""
    parser = argparse.ArgumentParser(prog="calm_edge.evaluation.targets", description=__doc__)
    parser.add_argument("--only", action="append", metavar="NAME", choices=[r.name for r in ROWS])
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(argv)
    done: list[Measured] = []
    for row in ROWS:
        if options.only and row.name not in options.only:
            continue
        print(f"{row.name} ...", file=sys.stderr, flush=True)
        try:
            measured = run_row(row, options.out / row.name)
        except CalmEdgeError as error:
            measured = Measured(row.name, (("run", "works", str(error), False),))
        done.append(measured)
        report = [_plain(m) for m in done]
        (options.out / "report.json").write_text(json.dumps(report, indent=1) + "\n")
    rows: list[list[Any]] = []
    for measured in done:
        rows += [[measured.name, *check] for check in measured.checks]
        if measured.skipped:
            rows.append([measured.name, "skipped", "", measured.skipped, None])
    print_rows(("on", "what", "asked", "measured", "pass"), rows, "calm-edge against its targets")
    return 0 if all(passed for m in done for *_, passed in m.checks) else 1


if __name__ == "__main__":
    sys.exit(main())
