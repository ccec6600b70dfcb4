"""Trajectories as text: TUM rows (`t x y z qx qy qz qw`) and KITTI rows (12 numbers of [R|t]).

TUM is written by `trajectories`.
"""

from __future__ import annotations

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import CalmEdgeError, Float, Int


class EvaluationError(CalmEdgeError):
    """Something given to the evaluation cannot be read or compared."""


def rotations(q: Float) -> Float:
    """(..., 4) unit quaternions x y z w -> (..., 3, 3)."""
    v, w = q[..., :3], q[..., 3:, None]
    V = se3.hat(v)
    return np.asarray(np.eye(3) + 2 * w * V + 2 * V @ V)


def kitti_text(T_w_c: Float) -> str:
    """T_w_c (N, 4, 4) -> KITTI text: the rows of [R|t], a pose a line."""
    rows = T_w_c[:, :3].reshape(-1, 12)
    return "".join(" ".join(f"{v:.9e}" for v in row) + "\n" for row in rows)


def write_kitti(path: Path, T_w_c: Float) -> None:
    """Write T_w_c (N, 4, 4) as a KITTI file."""
    path.write_text(kitti_text(T_w_c))


def _rows(path: Path, columns: int, what: str) -> list[tuple[int, list[str]]]:
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not text"
        raise EvaluationError(f"{path}: cannot be read ({reason})") from None
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) != columns:
            raise EvaluationError(
                f"{path}:{number}: {len(words)} columns; {what} rows have {columns}"
            )
        rows.append((number, words))
    if not rows:
        raise EvaluationError(f"{path}: holds no poses")
    return rows


def _numbers(path: Path, number: int, words: list[str]) -> Float:
    try:
        values = np.array([float(w) for w in words])
    except ValueError:
        raise EvaluationError(f"{path}:{number}: not a row of numbers") from None
    if not np.isfinite(values).all():
        raise EvaluationError(f"{path}:{number}: not finite")
    return values


def read_tum(path: Path) -> tuple[Int, Float]:
    """TUM file -> t_ns (N,) exact, T_w_c (N, 4, 4), sorted by time; raises EvaluationError."""
    stamps, values = [], []
    for number, words in _rows(path, 8, "TUM"):
        row = _numbers(path, number, words)
        try:
            stamps.append(int((Decimal(words[0]) * 10**9).to_integral_value()))
        except InvalidOperation:
            raise EvaluationError(f"{path}:{number}: {words[0]} is not a time") from None
        if np.linalg.norm(row[4:]) < 1e-6:
            raise EvaluationError(f"{path}:{number}: the quaternion is zero")
        values.append(row)
    t_ns, table = np.array(stamps, np.int64), np.array(values)
    order = np.argsort(t_ns, kind="stable")
    q = table[:, 4:] / np.linalg.norm(table[:, 4:], axis=1, keepdims=True)
    return t_ns[order], se3.compose(rotations(q), table[:, 1:4])[order]


def read_kitti(path: Path) -> Float:
    """KITTI file -> T_w_c (N, 4, 4); raises EvaluationError."""
    rows = [_numbers(path, number, words) for number, words in _rows(path, 12, "KITTI")]
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3] = np.array(rows).reshape(-1, 3, 4)
    return T
