"""Python environments of the rivals, and running a rival's process in one."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.drives import ROOT
from bench.process import last_line
from calm_edge.evaluation import EvaluationError
from calm_edge.geometry import se3
from calm_edge.types import Float, Int

RIVALS = ROOT / "build" / "rivals"
INSTALL_LIMIT_S = 600
RUN_LIMIT_S = 3 * 3600


class RivalMissing(EvaluationError):
    """A rival or its input is missing on this machine, so its rows are skipped."""


@dataclass(frozen=True, slots=True)
class RivalRun:
    """Result of a rival on a drive.

    t_ns: (N,) stamps of the primary frames with a pose, on SequenceFolder's clock. T_w_c: (N, 4,
    4), any unit; of ORB-SLAM3, of its rectified camera. frames: number of input frames. cpu_s:
    processor time of all threads, without start-up.
    """

    t_ns: Int
    T_w_c: Float
    frames: int
    cpu_s: float
    wall_s: float
    focal_px: tuple[float, ...] = ()


def environment(name: str, *packages: str) -> Path:
    """Make the Python environment build/rivals/`name` with `packages`; return its interpreter.

    An existing one is used again if its file `ready` lists the same packages. Raises RivalMissing.
    """
    folder = RIVALS / name
    python, ready = folder / "bin" / "python", folder / "ready"
    wanted = "\n".join(packages)
    if python.is_file() and ready.is_file() and ready.read_text() == wanted:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    steps = (
        [sys.executable, "-m", "venv", str(folder)],
        [str(python), "-m", "pip", "install", "-q", "--disable-pip-version-check", *packages],
    )
    for step in steps:
        try:
            done = subprocess.run(
                step, capture_output=True, text=True, check=False, timeout=INSTALL_LIMIT_S
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise RivalMissing(f"{name} cannot be installed ({type(error).__name__})") from None
        if done.returncode:
            raise RivalMissing(f"{name} cannot be installed ({last_line(done)})")
    ready.write_text(wanted)
    return python


def run_process(python: Path, script: Path, job: Mapping[str, Any], work: Path) -> RivalRun:
    """Run `script` on the job, written to work/job.json, and read its work/result.json.

    result.json: `t_ns` [N], `T_w_c` [N][16] row-major, `frames`, `cpu_s`, `focal_px` []. Raises
    EvaluationError if the file is missing.
    """
    work.mkdir(parents=True, exist_ok=True)
    answer = work / "result.json"
    answer.unlink(missing_ok=True)
    (work / "job.json").write_text(json.dumps(dict(job)))
    start = time.monotonic()
    with (work / "log.txt").open("w") as log:
        try:
            done = subprocess.run(
                [str(python), str(script), str(work / "job.json"), str(answer)],
                stdout=log,
                stderr=subprocess.STDOUT,
                check=False,
                timeout=RUN_LIMIT_S,
            )
        except subprocess.TimeoutExpired:
            raise EvaluationError(f"{script.stem}: not finished after {RUN_LIMIT_S} s") from None
    wall_s = time.monotonic() - start
    # with a result, a crash at shutdown does not matter
    if not answer.is_file():
        raise EvaluationError(
            f"{script.stem}: exit {done.returncode} without a result; see {work / 'log.txt'}"
        )
    result = json.loads(answer.read_text())
    t_ns = np.array(result["t_ns"], np.int64)
    T = np.array(result["T_w_c"], np.float64).reshape(len(t_ns), 4, 4)
    order = np.argsort(t_ns, kind="stable")
    return RivalRun(
        t_ns[order],
        se3.compose(T[order, :3, :3], T[order, :3, 3]),
        int(result["frames"]),
        float(result["cpu_s"]),
        wall_s,
        tuple(float(f) for f in result.get("focal_px", ())),
    )
