"""Measure time and memory of a model for increasing numbers of views, up to the limits.

The runs are made in a child process (`probe_process`), which may run out of memory.
"""

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

# Share of the available memory a model may use; capture, tracker and optimiser need the rest.
MEMORY_SHARE = 0.6
STEPS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
LOAD_LIMIT_S = 300.0


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a run in time and peak memory. size: width, height [px] of the test images."""

    seconds: float
    memory_mb: float
    size: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Measured:
    """Time and memory of a run. views: 0 for a golden case. what: its `role/case`, else empty."""

    precision: Precision
    views: int
    what: str
    seconds: float
    peak_mb: float


def free_memory_mb() -> float:
    """Memory available without swapping (MemAvailable of /proc/meminfo), MB."""
    for line in Path("/proc/meminfo").read_text().splitlines():
        if line.startswith("MemAvailable:"):
            return int(line.split()[1]) / 1024
    raise ManifestError("/proc/meminfo: has no line MemAvailable; Linux 3.14 or newer is needed")


def steps(frames: FrameRange) -> list[int]:
    """Numbers of views to measure, ascending from at least two to the maximum of the range."""
    least = max(2, frames.min)
    return sorted({n for n in (least, *STEPS, frames.max) if least <= n <= frames.max})


def ladder(manifest: Manifest, precision: Precision, limits: Limits) -> tuple[list[Measured], str]:
    """Measure increasing numbers of views within the limits; also returns the reason of the end.

    A step is skipped if its predicted memory exceeds the limit (quadratic in the number of views,
    as attention is). Raises ManifestError if the first step fails.
    """
    found: list[Measured] = []
    with _child(manifest, precision, limits) as child:
        empty_mb = child.ask(None, LOAD_LIMIT_S)["peak_mb"]
        for views in steps(manifest.frames):
            if found:
                last = found[-1]
                growth = (views / last.views) ** 2
                predicted_mb = empty_mb + (last.peak_mb - empty_mb) * growth
                if predicted_mb > limits.memory_mb:
                    return found, (
                        f"{views} views would take up to {predicted_mb:.0f} MB, "
                        f"more than the {limits.memory_mb:.0f} MB allowed"
                    )
            # twice the limit: for a warm-up run and a timed run
            answer = child.ask({"views": views}, 2 * limits.seconds)
            over = answer.get("over") or _over(answer, limits)
            if over and not found:
                raise ManifestError(f"{precision}: {views} views do not run here: {over}")
            if over:
                return found, f"{views} views: {over}"
            found.append(Measured(precision, views, "", answer["seconds"], answer["peak_mb"]))
    return found, "maximum of the manifest"


def golden_runs(
    manifest: Manifest, precision: Precision, names: list[str], limits: Limits
) -> list[Measured]:
    """Measure all golden cases. Raises ManifestError if one exceeds the limits."""
    found: list[Measured] = []
    with _child(manifest, precision, limits) as child:
        child.ask(None, LOAD_LIMIT_S)
        for index, name in enumerate(names):
            answer = child.ask({"case": index}, 2 * limits.seconds)
            over = answer.get("over") or _over(answer, limits)
            if over:
                raise ManifestError(f"{precision}: {name} does not run here: {over}")
            found.append(Measured(precision, 0, name, answer["seconds"], answer["peak_mb"]))
    return found


def _over(answer: dict[str, Any], limits: Limits) -> str:
    """The limit that a measurement exceeds, as text; empty if none."""
    if answer["peak_mb"] > limits.memory_mb:
        return f"{answer['peak_mb']:.0f} MB, more than {limits.memory_mb:.0f} MB"
    if answer["seconds"] > limits.seconds:
        return f"{answer['seconds']:.1f} s, more than {limits.seconds:.1f} s"
    return ""


class _Child:
    """The child process that runs the model, and its two pipes."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def ask(self, request: dict[str, int] | None, limit_s: float) -> dict[str, Any]:
        """Send a request (None: wait until the model is loaded) and return the answer.

        Without an answer within limit_s, the result has only the key `over`, with the reason.
        Raises ManifestError if the child reports an error.
        """
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
                raise ManifestError(f"the measuring process failed to start (exit {code})")
            return {"over": f"the measuring process died (exit {code}), maybe out of memory"}
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise ManifestError(answer["error"])
        return answer


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
