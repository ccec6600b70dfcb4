"""Load and run an ONNX graph. No other module imports ONNX Runtime."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError

try:
    import onnxruntime
except ModuleNotFoundError:
    raise BackboneError(
        "onnxruntime: not installed; run `pip install onnxruntime`, or set backbone.name=bundle"
    ) from None

Tensor = NDArray[Any]

# in order of preference; not TensorRT, which takes minutes to build its engines
_PROVIDERS = ("CUDAExecutionProvider", "CPUExecutionProvider")
_DTYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(int64)": np.int64,
    "tensor(int32)": np.int32,
    "tensor(uint8)": np.uint8,
    "tensor(int8)": np.int8,
    "tensor(bool)": np.bool_,
}


def default_threads() -> int:
    """Number of inference threads: all cores but one, which is left for capture."""
    return max(1, len(os.sched_getaffinity(0)) - 1)


def _providers() -> list[str]:
    available = onnxruntime.get_available_providers()
    return [p for p in _PROVIDERS if p in available]


@dataclass(frozen=True, slots=True)
class TensorSpec:
    """An input or output of a graph. shape: None for dimensions of any size."""

    name: str
    shape: tuple[int | None, ...]
    dtype: np.dtype[Any]

    def __str__(self) -> str:
        return f"{self.name} ({', '.join('any' if d is None else str(d) for d in self.shape)})"


class Session:
    """A loaded graph. inputs, outputs: its tensors by name."""

    def __init__(
        self,
        path: Path,
        *,
        threads: int | None = None,
        needs_inputs: Iterable[str] = (),
        needs_outputs: Iterable[str] = (),
    ) -> None:
        """Load a graph. threads: None for `default_threads`. needs_*: names of required tensors.

        Raises BackboneError if the file cannot be loaded or lacks one of these.
        """
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads or default_threads()
        options.inter_op_num_threads = 1
        options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
        options.use_deterministic_compute = True
        # threads that busy-wait would take CPU time from capture
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # the number of views varies, and ONNX Runtime would keep a memory plan for each
        options.enable_mem_pattern = False
        options.log_severity_level = 4
        self.path = path
        if not path.is_file():
            raise BackboneError(f"{path}: no such graph; fetch or export the model again")
        try:
            self._session = onnxruntime.InferenceSession(str(path), options, providers=_providers())
        except Exception as error:
            raise BackboneError(f"{path}: cannot be loaded: {_line(error)}") from None
        self.inputs = {a.name: self._spec(a) for a in self._session.get_inputs()}
        self.outputs = {a.name: self._spec(a) for a in self._session.get_outputs()}
        for what, needed, have in (
            ("input", needs_inputs, self.inputs),
            ("output", needs_outputs, self.outputs),
        ):
            for name in needed:
                if name not in have:
                    raise BackboneError(f"{path}: has no {what} {name!r}; it has {', '.join(have)}")

    def run(
        self, feeds: Mapping[str, Tensor], outputs: Iterable[str] | None = None
    ) -> dict[str, Tensor]:
        """Run the graph on inputs by name; returns all outputs, or those named.

        Inputs are cast to the graph's types. Raises BackboneError for a missing, unknown or
        wrongly shaped input, or if the run fails.
        """
        for name in feeds:
            if name not in self.inputs:
                known = ", ".join(self.inputs)
                raise BackboneError(f"{self.path}: has no input {name!r}; it has {known}")
        ready: dict[str, Tensor] = {}
        for name, spec in self.inputs.items():
            if name not in feeds:
                raise BackboneError(f"{self.path}: input {name!r} was not given")
            ready[name] = self._fitted(spec, np.asarray(feeds[name]))
        names = list(self.outputs) if outputs is None else list(outputs)
        try:
            values = self._session.run(names, ready)
        except Exception as error:
            shapes = ", ".join(f"{k} {v.shape}" for k, v in ready.items())
            raise BackboneError(f"{self.path}: failed on {shapes}: {_line(error)}") from None
        return dict(zip(names, values, strict=True))

    def _fitted(self, spec: TensorSpec, value: Tensor) -> Tensor:
        fits = value.ndim == len(spec.shape) and all(
            wanted is None or wanted == size
            for wanted, size in zip(spec.shape, value.shape, strict=True)
        )
        if not fits:
            raise BackboneError(f"{self.path}: input {spec} was given the shape {value.shape}")
        return np.ascontiguousarray(value, dtype=spec.dtype)

    def _spec(self, arg: Any) -> TensorSpec:
        if arg.type not in _DTYPES:
            raise BackboneError(f"{self.path}: {arg.name}: type {arg.type} is not supported")
        shape = tuple(d if isinstance(d, int) else None for d in arg.shape)
        return TensorSpec(arg.name, shape, np.dtype(_DTYPES[arg.type]))


def _line(error: Exception) -> str:
    """Error message of ONNX Runtime without its prefix, on one line, truncated."""
    text = " ".join(str(error).split()).removeprefix("[ONNXRuntimeError] : ")
    return text if len(text) <= 300 else f"{text[:300]}..."
