"""Patches of published networks for operations that cannot be exported to ONNX.

The rotary position embedding is implemented from its definition (Su et al., "RoFormer", 2021).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch

# (class, module or object, name of the attribute, temporary value)
Patch = tuple[Any, str, Any]


@contextmanager
def applied(patches: Sequence[Patch]) -> Iterator[None]:
    """Context in which the patches are applied."""
    before = [(owner, name, vars(owner).get(name)) for owner, name, _ in patches]
    for owner, name, value in patches:
        setattr(owner, name, value)
    try:
        yield
    finally:
        for owner, name, value in before:
            if value is None:
                delattr(owner, name)
            else:
                setattr(owner, name, value)


def rope(getter: type, rotary: type, base: str) -> list[Patch]:
    """Patches for a model's class of grid positions and its class of rotary embedding.

    base: name of the attribute of `rotary` with the base frequency.
    """

    def rotate(self: Any, tokens: torch.Tensor, positions: torch.Tensor) -> torch.Tensor:
        return rotated(tokens, positions, getattr(self, base))

    def grid(self: Any, batch: int, height: int, width: int, device: torch.device) -> torch.Tensor:
        return grid_positions(batch, height, width, device)

    return [(getter, "__call__", grid), (rotary, "forward", rotate)]


def grid_positions(batch: int, height: int, width: int, device: torch.device) -> torch.Tensor:
    """Row and column (batch, height * width, 2), int64, of a grid in row-major order.

    Without a cache and without cartesian_prod, which cannot be exported.
    """
    rows = torch.arange(height, device=device)
    columns = torch.arange(width, device=device)
    grid = torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1)
    return grid.reshape(1, height * width, 2).repeat(batch, 1, 1)


def rotated(tokens: torch.Tensor, positions: torch.Tensor, base: float) -> torch.Tensor:
    """Rotary embedding of tokens (B, heads, T, D) by row (first half of D) and column (second).

    positions: (B, T, 2). In each half, channels k and k + D / 4 are rotated by
    position * base^(-4 k / D). Angles are computed from the positions, in float32, since the size
    of a lookup table would become a constant of the graph.
    """
    quarter = tokens.shape[-1] // 4
    exponents = torch.arange(quarter, device=tokens.device, dtype=torch.float32) / quarter
    angles = positions[:, None, :, :, None].float() * base**-exponents
    cos, sin = angles.cos().to(tokens.dtype), angles.sin().to(tokens.dtype)
    planes = tokens.unflatten(-1, (2, 2, quarter))
    a, b = planes[..., 0, :], planes[..., 1, :]
    return torch.stack((a * cos - b * sin, b * cos + a * sin), -2).flatten(-3)
