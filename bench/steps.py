"""Steps of a measurement, each run as a `calm-edge` process, as a user would."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.drives import ROOT
from bench.process import last_line
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.evaluation import EvaluationError


@dataclass(frozen=True, slots=True)
class Cost:
    """Time of one step. cpu_s: processor time of the process and all its children."""

    wall_s: float
    cpu_s: float


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def process(*arguments: str, checkout: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run a calm-edge command, whatever its exit code. checkout: whose code is run."""
    return subprocess.run(
        [sys.executable, "-m", "calm_edge.cli", *arguments],
        cwd=checkout,
        capture_output=True,
        text=True,
        check=False,
    )


def calm_edge(
    *arguments: str, accept: Sequence[int] = (OK,), checkout: Path = ROOT
) -> tuple[str, Cost]:
    """Run a calm-edge command; return its stdout and cost.

    accept: exit codes that are no error. For any other one EvaluationError is raised with the last
    line of output. checkout: whose code is run.
    """
    start, before = time.monotonic(), _children_s()
    done = process(*arguments, checkout=checkout)
    if done.returncode not in accept:
        raise EvaluationError(
            f"calm-edge {arguments[0]}: exit {done.returncode}: {last_line(done)}"
        )
    return done.stdout, Cost(time.monotonic() - start, _children_s() - before)


def record(sequence: Path, out: Path, options: Sequence[str] = (), checkout: Path = ROOT) -> Cost:
    """Record a sequence folder in lockstep into `out`, which is replaced.

    Exit code 3 is accepted: then the recording is complete, but some frames have no pose.
    """
    shutil.rmtree(out, ignore_errors=True)
    arguments = ("--sequence", str(sequence), "--out", str(out), "--pace", "lockstep", *options)
    return calm_edge("record", *arguments, accept=(OK, LOSS), checkout=checkout)[1]


def dense_map(recording: Path, out: Path) -> Cost:
    """Make the dense map of a recording in `out`, which is replaced."""
    shutil.rmtree(out, ignore_errors=True)
    return calm_edge("map", str(recording), "--out", str(out), accept=(OK, LOSS))[1]


def figures(target: Path, truth: Path, checkout: Path = ROOT) -> dict[str, Any]:
    """Result of `calm-edge eval --json` for a recording or a map, also one without a metre."""
    arguments = ("eval", str(target), "--truth", str(truth), "--json")
    result = json.loads(calm_edge(*arguments, accept=(OK, LOSS), checkout=checkout)[0])
    assert isinstance(result, dict)
    return result
