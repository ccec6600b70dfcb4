"""Merge trajectories of successive updates; read and write TUM and KITTI files.

TUM rows are `t x y z qx qy qz qw`; KITTI rows are the 12 numbers of [R|t].
"""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import CalmEdgeError, Float, Int, Trajectory


class TrajectoryError(CalmEdgeError):
    """A trajectory file cannot be read; the text names file, line and fault."""


def folded(pieces: Iterable[Trajectory]) -> Trajectory | None:
    """Merge trajectories given in order; a keyframe in several takes its pose from the last.

    T_p_a and epoch are those of the last trajectory. None if none is given.
    """
    pieces = list(pieces)
    if not pieces:
        return None
    ids = np.concatenate([piece.keyframe_ids for piece in pieces])
    # np.unique returns the first index, which in reversed order is the latest row
    kept, reverse = np.unique(ids[::-1], return_index=True)
    rows = len(ids) - 1 - reverse
    return Trajectory(
        kept,
        np.concatenate([piece.t_ns for piece in pieces])[rows],
        np.concatenate([piece.T_w_c for piece in pieces])[rows],
        pieces[-1].T_p_a,
        pieces[-1].epoch,
    )


def seconds(t_ns: int) -> str:
    """Format ns as seconds, exactly."""
    whole, rest = divmod(abs(t_ns), 10**9)
    return f"{'-' if t_ns < 0 else ''}{whole}.{rest:09d}"


def tum_text(t_ns: Int, T_w_c: Float) -> str:
    """Format t_ns (N,), T_w_c (N, 4, 4) as TUM rows, seconds exact to the nanosecond."""
    q = se3.quaternions(T_w_c[:, :3, :3])
    lines = []
    for t, p, r in zip(t_ns, T_w_c[:, :3, 3], q, strict=True):
        # adding 0.0 turns -0.0 into 0.0, so equal poses are equal bytes
        values = " ".join(f"{v + 0.0:.9f}" for v in (*np.round(p, 9), *np.round(r, 9)))
        lines.append(f"{seconds(int(t))} {values}\n")
    return "".join(lines)


def write_tum(path: Path, t_ns: Int, T_w_c: Float) -> None:
    """Write t_ns (N,), T_w_c (N, 4, 4) as a TUM file."""
    path.write_text(tum_text(t_ns, T_w_c))


def kitti_text(T_w_c: Float) -> str:
    """Format T_w_c (N, 4, 4) as KITTI rows, one pose [R|t] per line."""
    rows = T_w_c[:, :3].reshape(-1, 12)
    return "".join(" ".join(f"{v:.9e}" for v in row) + "\n" for row in rows)


def write_kitti(path: Path, T_w_c: Float) -> None:
    """Write T_w_c (N, 4, 4) as a KITTI file."""
    path.write_text(kitti_text(T_w_c))


def _rows(path: Path, columns: int, what: str) -> list[tuple[int, list[str]]]:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise TrajectoryError(f"{path}: cannot be read ({reason})") from None
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != columns:
            raise TrajectoryError(
                f"{path}:{number}: {len(words)} columns; {what} rows have {columns}"
            )
        rows.append((number, words))
    if not rows:
        raise TrajectoryError(f"{path}: contains no poses")
    return rows


def _numbers(path: Path, number: int, words: list[str]) -> Float:
    try:
        values = np.array([float(w) for w in words])
    except ValueError:
        raise TrajectoryError(f"{path}:{number}: not a row of numbers") from None
    if not np.isfinite(values).all():
        raise TrajectoryError(f"{path}:{number}: contains inf or nan")
    return values


def read_tum(path: Path) -> tuple[Int, Float]:
    """Read t_ns (N,), exact, and T_w_c (N, 4, 4) of a TUM file, sorted by time.

    Raises TrajectoryError.
    """
    stamps, values = [], []
    for number, words in _rows(path, 8, "TUM"):
        row = _numbers(path, number, words)
        try:
            stamps.append(int((Decimal(words[0]) * 10**9).to_integral_value()))
        except InvalidOperation:
            raise TrajectoryError(f"{path}:{number}: {words[0]} is not a time") from None
        if np.linalg.norm(row[4:]) < 1e-6:
            raise TrajectoryError(f"{path}:{number}: the quaternion is zero")
        values.append(row)
    t_ns, table = np.array(stamps, np.int64), np.array(values)
    order = np.argsort(t_ns, kind="stable")
    q = table[:, 4:] / np.linalg.norm(table[:, 4:], axis=1, keepdims=True)
    return t_ns[order], se3.compose(se3.rotations(q), table[:, 1:4])[order]


def read_kitti(path: Path) -> Float:
    """Read T_w_c (N, 4, 4) of a KITTI file; raises TrajectoryError."""
    rows = [_numbers(path, number, words) for number, words in _rows(path, 12, "KITTI")]
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = np.array(rows).reshape(-1, 3, 4)
    return T
