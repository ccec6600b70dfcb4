"""Program of the child process that measures runs of a model; JSON lines on stdin and stdout.

`python -m calm_edge.backbones.model_check.probe_process FOLDER PRECISION WIDTH HEIGHT`. Request
`{"views": N}` runs N images of that size (feedforward), `{"case": I}` a golden case (bundle).
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np

from calm_edge.backbones.feedforward.network import Network
from calm_edge.backbones.model_check.golden import read_cases
from calm_edge.backbones.onnx.manifest import Manifest, Precision
from calm_edge.backbones.onnx.model_folder import read_manifest
from calm_edge.backbones.onnx.picture_input import fit_pictures
from calm_edge.backbones.onnx.session import Session
from calm_edge.types import CalmEdgeError

# The timed run is repeated until there are RUNS runs, or they take ENOUGH_S in total.
RUNS, ENOUGH_S = 5, 1.0


def peak_mb() -> float:
    """Peak resident memory of this process, MB (VmHWM).

    Not from getrusage, whose maximum may be inherited from the parent process.
    """
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    return 0.0


def runs_of(
    manifest: Manifest, precision: Precision, size: tuple[int, int]
) -> Callable[[dict[str, Any]], Callable[[], object]]:
    """Load the graphs; return a function that converts a request into the call to be timed.

    Raises CalmEdgeError.
    """
    if manifest.kind == "bundle":
        sessions = {role: Session(manifest.graph_path(role, precision)) for role in manifest.graphs}
        cases = read_cases(manifest)

        def of_case(request: dict[str, Any]) -> Callable[[], object]:
            case = cases[int(request["case"])]
            return lambda: sessions[case.role].run(case.inputs)

        return of_case
    network = Network(manifest, precision)
    noise = np.random.default_rng(0)

    def of_views(request: dict[str, Any]) -> Callable[[], object]:
        width, height = size
        images = [noise.integers(0, 256, (height, width, 3), np.uint8)] * int(request["views"])
        fits = fit_pictures(manifest.input, [size] * len(images))
        return lambda: network.raw(images, fits)

    return of_views


def timed(run: Callable[[], object]) -> float:
    """Median time [s] of a few runs after a warm-up run."""
    run()
    seconds: list[float] = []
    while len(seconds) < RUNS and sum(seconds) < ENOUGH_S:
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return median(seconds)


def main(arguments: list[str]) -> None:
    """Answer requests until stdin ends; a CalmEdgeError is sent as an answer."""
    folder, precision, width, height = arguments
    cv2.setNumThreads(1)

    def answer(**values: object) -> None:
        print(json.dumps(values), flush=True)

    try:
        manifest = read_manifest(Path(folder))
        chosen = next(p for p in manifest.precisions() if p == precision)
        runs = runs_of(manifest, chosen, (int(width), int(height)))
        answer(peak_mb=peak_mb())
        for line in sys.stdin:
            seconds = timed(runs(json.loads(line)))
            answer(seconds=seconds, peak_mb=peak_mb())
    except CalmEdgeError as error:
        answer(error=str(error))


if __name__ == "__main__":
    main(sys.argv[1:])
