"""What published networks do that an ONNX graph cannot: replaced from outside, while it is traced.

A rotary embedding is written here from its definition; nothing of the authors' code is in it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch

# owner (class, module or object), name, what stands there meanwhile
Patch = tuple[Any, str, Any]


@contextmanager
def applied(patches: Sequence[Patch]) -> Iterator[None]:
    """Every patch in place inside the block, everything as before behind it."""
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
    """For a class that gives grid positions and one that rotates by them, of any of the models.

    base: the attribute of `rotary` that holds its base frequency.
    """

    def rotate(self: Any, tokens: torch.Tensor, positions: torch.Tensor) -> torch.Tensor:
        return rotated(tokens, positions, getattr(self, base))

    def grid(self: Any, batch: int, height: int, width: int, device: torch.device) -> torch.Tensor:
        return grid_positions(batch, height, width, device)

    return [(getter, "__call__", grid), (rotary, "forward", rotate)]


def grid_positions(batch: int, height: int, width: int, device: torch.device) -> torch.Tensor:
    """(batch, height * width, 2) int64 row and column, row by row. No cache, no cartesian_prod."""
    rows = torch.arange(height, device=device)
    columns = torch.arange(width, device=device)
    grid = torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1)
    return grid.reshape(1, height * width, 2).repeat(batch, 1, 1)


def rotated(tokens: torch.Tensor, positions: torch.Tensor, base: float) -> torch.Tensor:
    """Tokens (B, heads, T, D) turned by their rows (first half of D) and columns (second half).

    positions: (B, T, 2). In each half, channel k and channel k + D / 4 are a plane that turns by
    position * base^(-4 k / D). The angles come from the positions themselves, in float32: a table
    as long as the largest position would be as long as it was while traced.
    """
    quarter = tokens.shape[-1] // 4
    exponents = torch.arange(quarter, device=tokens.device, dtype=torch.float32) / quarter
    angles = positions[:, None, :, :, None].float() * base**-exponents
    cos, sin = angles.cos().to(tokens.dtype), angles.sin().to(tokens.dtype)
    planes = tokens.unflatten(-1, (2, 2, quarter))
    a, b = planes[..., 0, :], planes[..., 1, :]
    return torch.stack((a * cos - b * sin, b * cos + a * sin), -2).flatten(-3)
