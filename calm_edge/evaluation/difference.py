"""What differs between two estimates: their figures side by side, and their paths overlaid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calm_edge.evaluation import trajectory
from calm_edge.evaluation.results import MIN_POSES
from calm_edge.evaluation.side import Figure, Side
from calm_edge.evaluation.table import pretty
from calm_edge.geometry import se3
from calm_edge.geometry.similarity import Similarity, align
from calm_edge.types import Float


@dataclass(frozen=True, slots=True)
class Overlay:
    """Two paths in the world of the first.

    path_a, path_b: (N, 3), (M, 3). by: how the second was placed, in words. poses: compared, 0 if
    the drives have no common stamps. rms, most: distance of common keyframes, in the unit of the
    first; None without common stamps. scale: factor by which the second was stretched.
    """

    path_a: Float
    path_b: Float
    by: str
    poses: int
    rms: float | None
    most: float | None
    scale: float


@dataclass(frozen=True, slots=True)
class Row:
    """A figure of both sides; None where a side has none."""

    key: str
    a: Figure | None
    b: Figure | None

    @property
    def figure(self) -> Figure:
        """The side that has the figure, for its names."""
        found = self.a or self.b
        assert found is not None
        return found

    @property
    def delta(self) -> float | None:
        """Second minus first, of numbers in one unit."""
        if self.a is None or self.b is None or self.a.unit != self.b.unit:
            return None
        if isinstance(self.a.value, str) or isinstance(self.b.value, str):
            return None
        return self.b.value - self.a.value

    def cells(self) -> tuple[str, str, str, str]:
        """Name, both values with their units, and the difference, as text."""
        texts = (
            "–" if f is None else f"{pretty(f.value)} {f.unit}".rstrip() for f in (self.a, self.b)
        )
        first, second = texts
        delta, change = self.delta, ""
        if delta is None:
            differs = self.a is not None and self.b is not None and first != second
            change = "differs" if differs else ""
        elif first != second:
            change = f"{delta:+.4g}"
            base = None if self.a is None or isinstance(self.a.value, str) else self.a.value
            if base and self.figure.unit not in ("%", "deg", "ms"):
                change += f" ({100 * delta / abs(base):+.2g} %)"
        return self.figure.name, first, second, change


def rows(a: Side, b: Side) -> list[Row]:
    """All figures that a side has, grouped, in the order of the first side."""
    keys = list(dict.fromkeys([*a.figures, *b.figures]))
    found = [Row(key, a.figures.get(key), b.figures.get(key)) for key in keys]
    groups = list(dict.fromkeys(row.figure.group for row in found))
    return sorted(found, key=lambda row: groups.index(row.figure.group))


def overlay(a: Side, b: Side) -> Overlay:
    """Place the path of the second in the world of the first.

    By the positions of keyframes with common stamps, with a scale unless both are in metres; if
    there are none, by the first keyframe of each.
    """
    T_a, T_b = a.estimate.T_w_c, b.estimate.T_w_c
    p_a, p_b = T_a[:, :3, 3], T_b[:, :3, 3]
    i, j = trajectory.associate(b.t_ns, a.t_ns)
    metric = a.estimate.metric and b.estimate.metric
    if len(i) >= MIN_POSES and np.ptp(p_b[i], axis=0).any():
        motion = align(p_b[i], p_a[j], with_scale=not metric)
        apart = np.linalg.norm(motion.points(p_b[i]) - p_a[j], axis=1)
        kind = "SE(3)" if metric else "Sim(3): the lengths of one of them are not metric"
        by = f"{len(i)} keyframes with common stamps, {kind}"
        rms = float(np.sqrt((apart**2).mean()))
        most = float(apart.max())
        return Overlay(p_a, motion.points(p_b), by, len(i), rms, most, motion.scale)
    if not len(p_a) or not len(p_b):
        return Overlay(p_a, p_b, "nothing: one has no path", 0, None, None, 1.0)
    motion = Similarity.from_matrix(T_a[0] @ se3.inverse(T_b[0]))
    by = "their first keyframes: they have no common stamps, so that nothing is measured"
    return Overlay(p_a, motion.points(p_b), by, 0, None, None, 1.0)


def plain(a: Side, b: Side) -> dict[str, Any]:
    """JSON object: the figures of both sides, their differences, and the distance of the paths."""
    found = rows(a, b)
    placed = overlay(a, b)
    return {
        "a": _plain_side(a),
        "b": _plain_side(b),
        "difference": {row.key: row.delta for row in found if row.delta is not None},
        "paths": {
            "placed_by": placed.by,
            "common_keyframes": placed.poses,
            "rms": placed.rms,
            "largest": placed.most,
            "scale": placed.scale,
        },
    }


def _plain_side(side: Side) -> dict[str, Any]:
    values = {key: figure.value for key, figure in side.figures.items()}
    return {"path": str(side.path), "kind": side.kind, "missing": list(side.missing), **values}
