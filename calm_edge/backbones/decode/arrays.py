"""Output tensors of a graph, brought to one axis of views."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.types import Float


def of_views(name: str, raw: NDArray[Any], views: int, shape: tuple[int | None, ...]) -> Float:
    """(N, *shape) float64 of an output, axes of length one in front, behind or second dropped.

    None in `shape` is any length. Raises BackboneError.
    """
    wanted = (views, *shape)
    for axis in (None, 0, -1, 1):
        if axis is None:
            value = raw
        elif raw.ndim == len(wanted) + 1 and raw.shape[axis] == 1:
            value = raw.squeeze(axis)
        else:
            continue
        if value.ndim == len(wanted) and all(
            w is None or w == s for w, s in zip(wanted, value.shape, strict=True)
        ):
            return np.asarray(value, np.float64)
    text = ", ".join("any" if size is None else str(size) for size in wanted)
    raise BackboneError(f"output {name!r} has the shape {raw.shape}; expected ({text})")
