"""Seams: distances between the positions of common anchors in two sub-maps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calm_edge.geometry import se3
from calm_edge.mapping.deform import Deformation
from calm_edge.types import AnchorTable, Float, Float32

# of one seam in the map's page
MARKS = 200


@dataclass(frozen=True, slots=True)
class Seam:
    """Two sub-maps and the distances between their positions of each common anchor.

    gaps_before, gaps_after: (M,) distances before and after deformation, world units, M >= 1.
    marks: (K, 4) of at most MARKS anchors, spread evenly over these: their place in the world after
    deformation, and gap_after.
    """

    submap_a: int
    submap_b: int
    gaps_before: Float32
    gaps_after: Float32
    marks: Float32 = field(default_factory=lambda: np.zeros((0, 4), np.float32))


@dataclass(frozen=True, slots=True)
class SeamSummary:
    """Median and 95th percentile of the distances of all seams, world units."""

    n_seams: int
    n_anchors: int
    median_before: float
    median_after: float
    p95_before: float
    p95_after: float

    def __str__(self) -> str:
        return (
            f"{self.n_seams}; sub-maps apart by {self.median_before:.3g} before,"
            f" {self.median_after:.3g} after deformation (median of {self.n_anchors:,} anchors)"
        )


def summary(found: Sequence[Seam]) -> SeamSummary | None:
    """Statistics over the anchors of all seams, equally weighted; None without a seam."""
    if not found:
        return None
    before = np.concatenate([seam.gaps_before for seam in found])
    after = np.concatenate([seam.gaps_after for seam in found])
    (m_before, p_before), (m_after, p_after) = (np.percentile(g, [50, 95]) for g in (before, after))
    return SeamSummary(
        len(found),
        len(before),
        float(m_before),
        float(m_after),
        float(p_before),
        float(p_after),
    )


def seams(
    pairs: Iterable[tuple[int, int]],
    tables: Mapping[int, AnchorTable],
    T_w_s: Mapping[int, Float],
    deformations: Mapping[int, Deformation],
) -> tuple[Seam, ...]:
    """Seams of those pairs of sub-map ids that have common anchors, suppressed ones included."""
    found = []
    for a, b in pairs:
        common, in_a, in_b = np.intersect1d(tables[a].anchor, tables[b].anchor, return_indices=True)
        if not len(common):
            continue
        p_a, p_b = tables[a].p_s[in_a], tables[b].p_s[in_b]
        before = se3.transform(T_w_s[a], p_a) - se3.transform(T_w_s[b], p_b)
        bent_a = se3.transform(T_w_s[a], deformations[a].apply(p_a))
        bent_b = se3.transform(T_w_s[b], deformations[b].apply(p_b))
        gaps = [np.linalg.norm(p, axis=1).astype(np.float32) for p in (before, bent_a - bent_b)]
        middle = np.column_stack([(bent_a + bent_b) / 2, gaps[1]])
        marks = middle[:: max(-(-len(middle) // MARKS), 1)].astype(np.float32)
        found.append(Seam(a, b, gaps[0], gaps[1], marks))
    return tuple(found)
