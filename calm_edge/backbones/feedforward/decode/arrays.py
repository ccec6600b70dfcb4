"""Normalise the axes of a graph's output tensors: views first."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.types import Float


def of_views(name: str, raw: NDArray[Any], views: int, shape: tuple[int | None, ...]) -> Float:
    """Output as (N, *shape), float64, without batch and channel axes of length one.

    None in `shape` is any length. Raises BackboneError for other shapes.
    """
    wanted = (views, *shape)
    for value in _squeezed(raw, len(wanted)):
        if all(w is None or w == s for w, s in zip(wanted, value.shape, strict=True)):
            return np.asarray(value, np.float64)
    text = ", ".join("any" if size is None else str(size) for size in wanted)
    raise BackboneError(f"output {name!r} has the shape {raw.shape}; expected ({text})")


def _squeezed(raw: NDArray[Any], ndim: int) -> Iterator[NDArray[Any]]:
    """Yield versions of an output with `ndim` axes, removing batch or channel axes of length 1."""
    of_batch = [raw] + ([raw[0]] if raw.ndim > ndim and raw.shape[0] == 1 else [])
    for value in of_batch:
        if value.ndim == ndim:
            yield value
        for axis in (-1, 1):
            if value.ndim == ndim + 1 and value.shape[axis] == 1:
                yield value.squeeze(axis)
