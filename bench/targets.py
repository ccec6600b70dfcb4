"""Accuracy targets of calm-edge on whole drives.

Each row runs the commands that a user would: `record` in lockstep, `map`, `eval`. Results are kept
in build/eval/targets.json; a run of some rows replaces only their results.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from bench import steps
from bench.drives import DATA, ROOT, Prepare, late_assistant, plain_demo, simulated, there
from bench.tables import Check, Table, publish
from calm_edge.evaluation.estimate import read_estimate
from calm_edge.evaluation.results import MAX_FOCAL_SIGMA_PERCENT
from calm_edge.trajectories import tum_text
from calm_edge.types import CalmEdgeError

OUT = ROOT / "build" / "eval"
RESULTS = "targets.json"


class TargetError(CalmEdgeError):
    """A requirement cannot be checked."""


@dataclass(frozen=True, slots=True)
class Metric:
    """One requirement.

    key: of `eval --json`; if its value is a list, the entry largest in magnitude counts. most:
    largest value that passes. least: value that all entries must exceed, for a sigma; null entries,
    infinite sigmas, pass. may_be_null: null entries pass `most`, for quantities that are reported
    only if observed.
    """

    key: str
    asked: str
    most: float | None = None
    least: float | None = None
    may_be_null: bool = False


@dataclass(frozen=True, slots=True)
class Row:
    """One drive and its requirements.

    prepare: returns the sequence folder, or the reason why it is missing. options: of `record`.
    twice: record a second time and compare the bytes of the trajectories.
    """

    name: str
    prepare: Prepare
    options: tuple[str, ...] = ()
    metrics: tuple[Metric, ...] = ()
    twice: bool = False


@dataclass(frozen=True, slots=True)
class Measured:
    """Outcome of a row.

    result: of `eval --json`. seconds: by step. note: reason why there is no result.
    """

    checks: tuple[Check, ...] = ()
    result: Mapping[str, Any] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    note: str = ""


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
    Row(
        "demo_plain",
        plain_demo,
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
    """Check a requirement: (measured value, whether it passes).

    Raises TargetError if the result lacks the key.
    """
    if metric.key not in result:
        raise TargetError(f"eval --json: no key {metric.key}")
    value = result[metric.key]
    entries = value if isinstance(value, list) else [value]
    known = [abs(entry) for entry in entries if entry is not None]
    whole = metric.may_be_null or len(known) == len(entries)
    if metric.least is not None:
        return value, value is not None and all(entry > metric.least for entry in known)
    return value, whole and all(entry <= metric.most for entry in known if metric.most is not None)


def with_honesty(result: dict[str, Any]) -> dict[str, Any]:
    """Add `focal_error_in_sigma` to a result, per eye; None where the focal is not observed."""
    errors, sigmas = result.get("focal_error_percent"), result.get("focal_sigma_percent")
    ratio = [
        abs(e) / s if e is not None and s else None
        for e, s in zip(errors or (), sigmas or (), strict=True)
    ]
    return {**result, "focal_error_in_sigma": ratio}


def _trajectory(recording: Path) -> str:
    estimate = read_estimate(recording)
    return tum_text(estimate.t_ns, estimate.T_w_c)


def run_row(row: Row, out: Path) -> Measured:
    """Record, map and evaluate the drive of one row in `out`; raises CalmEdgeError."""
    out.mkdir(parents=True, exist_ok=True)
    sequence = row.prepare(out)
    if isinstance(sequence, str):
        return Measured(note=f"skipped: {sequence}")
    recording, made = out / "recording", out / "map"
    seconds = {"record": steps.record(sequence, recording, row.options).wall_s}
    if row.twice:
        again = out / "again"
        seconds["record again"] = steps.record(sequence, again, row.options).wall_s
        first, second = _trajectory(recording), _trajectory(again)
        same = bool(first) and first == second
        check = Check("trajectory bytes", "identical", "identical" if same else "different", same)
        return Measured((check,), {}, seconds)
    seconds["map"] = steps.dense_map(recording, made).wall_s
    result = with_honesty(steps.figures(made, sequence))
    checks = tuple(Check(m.key, m.asked, *judge(m, result)) for m in row.metrics)
    return Measured(checks, result, seconds)


def read_results(file: Path) -> dict[str, Measured]:
    """Read the results of earlier runs by row; empty if there are none."""
    if not file.is_file():
        return {}
    found = json.loads(file.read_text())
    return {
        name: Measured(**fields | {"checks": tuple(Check(**check) for check in fields["checks"])})
        for name, fields in found.items()
    }


# (column title, key of `eval --json`)
FIGURES = (
    ("SE(3) m", "ate_se3_m"),
    ("Sim(3) m", "ate_sim3_m"),
    ("% of path", "ate_percent"),
    ("focal error %", "focal_error_percent"),
    ("focal sigma %", "focal_sigma_percent"),
    ("chamfer m", "map_chamfer_m"),
)


def table(results: Mapping[str, Measured]) -> Table:
    """Table of all rows measured so far, in the order of ROWS, with their requirements."""
    known = [(row.name, results[row.name]) for row in ROWS if row.name in results]
    return Table(
        "10_targets",
        "calm-edge against its targets",
        "python -m bench targets",
        ("drive", *(header for header, _ in FIGURES), "record s", "map s"),
        tuple(
            (
                name,
                *(measured.result.get(key) for _, key in FIGURES),
                *(measured.seconds.get(step) for step in ("record", "map")),
            )
            for name, measured in known
        ),
        tuple(
            Check(f"{name}: {check.what}", check.asked, check.measured, check.passed)
            for name, measured in known
            for check in measured.checks
        ),
        (
            "recorded in lockstep; only eval reads calibration and truth",
            *(f"{name}: {measured.note}" for name, measured in known if measured.note),
        ),
    )


def run_all(rows: Iterable[Row], out: Path) -> dict[str, Measured]:
    """Run rows, writing each result to disk at once; a failed row is a missed requirement."""
    done: dict[str, Measured] = {}
    for row in rows:
        print(f"{row.name} ...", file=sys.stderr, flush=True)
        try:
            done[row.name] = run_row(row, out / row.name)
        except CalmEdgeError as error:
            failed = Check("run", "works", str(error), False)
            done[row.name] = Measured((failed,), note="failed")
        results = read_results(out / RESULTS) | done
        plain = {name: asdict(measured) for name, measured in results.items()}
        (out / RESULTS).write_text(json.dumps(plain, indent=1) + "\n")
    return done


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--only", action="append", metavar="NAME", choices=[r.name for r in ROWS])
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Run the rows, print and save the table; return 1 if a requirement is missed."""
    done = run_all((row for row in ROWS if row.name in (options.only or [row.name])), options.out)
    publish(table(read_results(options.out / RESULTS)), options.out)
    return 0 if all(check.passed for m in done.values() for check in m.checks) else 1
