"""One trajectory of the pieces that updates carry, and as a TUM file (`t x y z qx qy qz qw`)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Int, Trajectory


def folded(pieces: Iterable[Trajectory]) -> Trajectory | None:
    """The pieces in their order as one: of a keyframe said twice the later pose holds.

    None without a piece. T_p_a and epoch are those of the last one.
    """
    pieces = list(pieces)
    if not pieces:
        return None
    ids = np.concatenate([piece.keyframe_ids for piece in pieces])
    # the first of the reversed rows is the last said
    kept, reverse = np.unique(ids[::-1], return_index=True)
    rows = len(ids) - 1 - reverse
    return Trajectory(
        kept,
        np.concatenate([piece.t_ns for piece in pieces])[rows],
        np.concatenate([piece.T_w_c for piece in pieces])[rows],
        pieces[-1].T_p_a,
        pieces[-1].epoch,
    )


def quaternions(R: Float) -> Float:
    """(..., 3, 3) -> (..., 4) unit quaternions x y z w, w >= 0."""
    half = se3.so3_log(R) / 2
    angle = np.linalg.norm(half, axis=-1, keepdims=True)
    # sin(a) / a, continued through 0
    return np.concatenate([half * np.sinc(angle / np.pi), np.cos(angle)], -1)


def tum_text(t_ns: Int, T_w_c: Float) -> str:
    """t_ns (N,), T_w_c (N, 4, 4) -> TUM text, seconds exact to the nanosecond."""
    q = quaternions(T_w_c[:, :3, :3])
    lines = []
    for t, p, r in zip(t_ns, T_w_c[:, :3, 3], q, strict=True):
        seconds, rest = divmod(int(t), 1_000_000_000)
        # adding 0.0 turns -0.0 into 0.0, so equal poses are equal bytes
        values = " ".join(f"{v + 0.0:.9f}" for v in (*np.round(p, 9), *np.round(r, 9)))
        lines.append(f"{seconds}.{rest:09d} {values}\n")
    return "".join(lines)


def write_tum(path: Path, t_ns: Int, T_w_c: Float) -> None:
    """Write t_ns (N,), T_w_c (N, 4, 4) as a TUM file."""
    path.write_text(tum_text(t_ns, T_w_c))
