"""How many views a model can take here: time and memory, measured upwards until one is too much."""

from __future__ import annotations

import json
import select
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calm_edge.backbones.onnx.manifest import FrameRange, Manifest, ManifestError, Precision

# Of the memory that is free now, what a model may take: capture, tracker and optimiser need some.
MEMORY_SHARE = 0.6
STEPS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
LOAD_LIMIT_S = 300.0


@dataclass(frozen=True, slots=True)
class Limits:
    """seconds: for one run. memory_mb: the process's peak. size: width, height px of a picture."""

    seconds: float
    memory_mb: float
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Measured:
    """One run. views: 0 for a golden case, whose `role/case` is what."""

    precision: Precision
    views: int
    what: str
    seconds: float
    peak_mb: float


def free_memory_mb() -> float:
    """What may be taken without swapping, now."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable:"):
            return int(line.split()[1]) / 1024
    raise ManifestError("/proc/meminfo does not say how much memory is free")


def steps(frames: FrameRange) -> list[int]:
    """Numbers of views worth measuring, at least two, the largest of the range last."""
    least = max(2, frames.min)
    return sorted({n for n in (least, *STEPS, frames.max) if least <= n <= frames.max})


def ladder(manifest: Manifest, precision: Precision, limits: Limits) -> tuple[list[Measured], str]:
    """Every number of views that stays within the limits, and one line on what ended it.

    Before each step its memory is foreseen, growing as the square of the views: that of attention.
    Raises ManifestError where the first step fails.
    """
    found: list[Measured] = []
    with _child(manifest, precision, limits) as child:
        empty_mb = child.ask(None, LOAD_LIMIT_S)["peak_mb"]
        for views in steps(manifest.frames):
            if found:
                last = found[-1]
                growth = (views / last.views) ** 2
                foreseen_mb = empty_mb + (last.peak_mb - empty_mb) * growth
                if foreseen_mb > limits.memory_mb:
                    return found, (
                        f"{views} views would take up to {foreseen_mb:.0f} MB, "
                        f"of {limits.memory_mb:.0f} MB that may be used"
                    )
            # twice: a first run, and one that is timed
            said = child.ask({"views": views}, 2 * limits.seconds)
            over = said.get("over") or _over(said, limits)
            if over and not found:
                raise ManifestError(f"{precision}: {views} views do not run here: {over}")
            if over:
                return found, f"{views} views: {over}"
            found.append(Measured(precision, views, "", said["seconds"], said["peak_mb"]))
    return found, "all that the manifest allows"


def golden_runs(
    manifest: Manifest, precision: Precision, names: list[str], limits: Limits
) -> list[Measured]:
    """Time and memory of every golden case; raises ManifestError where one exceeds the limits."""
    found: list[Measured] = []
    with _child(manifest, precision, limits) as child:
        child.ask(None, LOAD_LIMIT_S)
        for index, name in enumerate(names):
            said = child.ask({"case": index}, 2 * limits.seconds)
            over = said.get("over") or _over(said, limits)
            if over:
                raise ManifestError(f"{precision}: {name} does not run here: {over}")
            found.append(Measured(precision, 0, name, said["seconds"], said["peak_mb"]))
    return found


def _over(said: dict[str, Any], limits: Limits) -> str:
    if said["peak_mb"] > limits.memory_mb:
        return f"{said['peak_mb']:.0f} MB, more than {limits.memory_mb:.0f} MB"
    if said["seconds"] > limits.seconds:
        return f"{said['seconds']:.1f} s, more than {limits.seconds:.1f} s"
    return ""


class _Child:
    """A probe process and its two pipes."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def ask(self, request: dict[str, int] | None, limit_s: float) -> dict[str, Any]:
        """Its answer; `over` in it says why there is none. Raises ManifestError for its error."""
        out = self._process.stdout
        assert out is not None and self._process.stdin is not None
        try:
            if request is not None:
                self._process.stdin.write(json.dumps(request) + "\n")
                self._process.stdin.flush()
            if not select.select([out], [], [], limit_s)[0]:
                return {"over": f"no answer after {limit_s:.0f} s"}
            line = out.readline()
        except BrokenPipeError:
            line = ""
        if not line:
            code = self._process.wait()
            if request is None:
                raise ManifestError(f"the process that measures ended at its start (exit {code})")
            return {"over": f"the process that ran it was ended (exit {code}), by lack of memory?"}
        said: dict[str, Any] = json.loads(line)
        if "error" in said:
            raise ManifestError(said["error"])
        return said


@contextmanager
def _child(manifest: Manifest, precision: Precision, limits: Limits) -> Iterator[_Child]:
    module = "calm_edge.backbones.model_check.probe_process"
    size = [str(length) for length in limits.size]
    with subprocess.Popen(
        [sys.executable, "-m", module, str(manifest.folder.resolve()), precision, *size],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield _Child(process)
        finally:
            process.kill()
