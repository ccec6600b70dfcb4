"""The steps of a measurement, each run the way a user would: a `calm-edge` process of its own."""

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
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.evaluation.errors import EvaluationError


@dataclass(frozen=True, slots=True)
class Cost:
    """Of one step. cpu_s: of its processes and theirs."""

    wall_s: float
    cpu_s: float


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def calm_edge(*arguments: str, accept: Sequence[int] = (OK,)) -> tuple[str, Cost]:
    """Its stdout and its cost; raises EvaluationError with its last line for another exit code."""
    start, before = time.monotonic(), _children_s()
    done = subprocess.run(
        [sys.executable, "-m", "calm_edge.cli", *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode not in accept:
        said = (done.stderr or done.stdout).strip().splitlines() or ["it said nothing"]
        raise EvaluationError(f"calm-edge {arguments[0]}: exit {done.returncode}: {said[-1]}")
    return done.stdout, Cost(time.monotonic() - start, _children_s() - before)


def record(sequence: Path, out: Path, options: Sequence[str] = ()) -> Cost:
    """A lockstep recording of a sequence folder in `out`, replacing what was there.

    A recording that is complete but not wholly placed (exit code 3) is one.
    """
    shutil.rmtree(out, ignore_errors=True)
    arguments = ("--sequence", str(sequence), "--out", str(out), "--pace", "lockstep", *options)
    return calm_edge("record", *arguments, accept=(OK, LOSS))[1]


def dense_map(recording: Path, out: Path) -> Cost:
    """Its dense map in `out`, replacing what was there."""
    shutil.rmtree(out, ignore_errors=True)
    return calm_edge("map", str(recording), "--out", str(out), accept=(OK, LOSS))[1]


def figures(target: Path, truth: Path) -> dict[str, Any]:
    """What `calm-edge eval --json` says of a recording or a map."""
    said = json.loads(calm_edge("eval", str(target), "--truth", str(truth), "--json")[0])
    assert isinstance(said, dict)
    return said
