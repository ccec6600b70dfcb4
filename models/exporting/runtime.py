"""Run an exported graph in ONNX Runtime, as calm-edge does; needs no torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

INPUT = "images"


def session(path: Path, threads: int = 1) -> onnxruntime.InferenceSession:
    """Session on the CPU."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    return onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def run(
    graph: onnxruntime.InferenceSession, image: NDArray[np.float32]
) -> dict[str, NDArray[np.float32]]:
    """Run a graph on an input tensor; returns its outputs by name."""
    names = [output.name for output in graph.get_outputs()]
    return dict(zip(names, graph.run(names, {INPUT: image}), strict=True))


def worst_error(
    found: dict[str, NDArray[np.float32]], expected: dict[str, NDArray[np.float32]]
) -> tuple[float, str]:
    """Largest error of any value over the standard deviation of its output, and that output's name.

    Not over the RMS: depth of random weights is nearly constant, so that this would hide errors.
    """
    errors = []
    for name, wanted in expected.items():
        spread = float(np.std(wanted.astype(np.float64)))
        gap = float(np.abs(found[name].astype(np.float64) - wanted).max())
        known = np.isfinite(gap) and spread > 0
        errors.append((gap / spread if known else float("inf"), name))
    return max(errors)
