"""Seams: distances between the positions of common anchors in two sub-maps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.mapping.deform import Deformation
from calm_edge.types import AnchorTable, Float, Float32


@dataclass(frozen=True, slots=True)
class Seam:
    """Two sub-maps and the distances between their positions of each common anchor.

    gaps_before, gaps_after: (M,) distances before and after deformation, world units, M >= 1.
    """

    submap_a: int
    submap_b: int
    gaps_before: Float32
    gaps_after: Float32

    @property
    def n_anchors(self) -> int:
        return len(self.gaps_before)

    @property
    def before(self) -> float:
        """RMS distance before deformation, world units."""
        return float(np.sqrt((self.gaps_before**2).mean()))

    @property
    def after(self) -> float:
        """RMS distance after deformation, world units."""
        return float(np.sqrt((self.gaps_after**2).mean()))


@dataclass(frozen=True, slots=True)
class SeamSummary:
    """Median and 95th percentile of the distances of all seams, world units."""

    n_seams: int
    n_anchors: int
    median_before: float
    median_after: float
    p95_before: float
    p95_after: float


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


def seam_between(
    rows_a: AnchorTable,
    rows_b: AnchorTable,
    T_w_a: Float,
    T_w_b: Float,
    deform_a: Deformation,
    deform_b: Deformation,
) -> Seam | None:
    """Seam of two sub-maps over all their common anchors, suppressed ones included.

    rows_a, rows_b: rows of one sub-map each. None without a common anchor.
    """
    shared, a, b = np.intersect1d(rows_a.anchor, rows_b.anchor, return_indices=True)
    if not len(shared):
        return None
    p_a, p_b = rows_a.p_s[a], rows_b.p_s[b]
    before = se3.transform(T_w_a, p_a) - se3.transform(T_w_b, p_b)
    after = se3.transform(T_w_a, deform_a.apply(p_a)) - se3.transform(T_w_b, deform_b.apply(p_b))
    return Seam(
        int(rows_a.submap[0]),
        int(rows_b.submap[0]),
        np.linalg.norm(before, axis=1).astype(np.float32),
        np.linalg.norm(after, axis=1).astype(np.float32),
    )


def seams(
    pairs: Iterable[tuple[int, int]],
    tables: Mapping[int, AnchorTable],
    T_w_s: Mapping[int, Float],
    deformations: Mapping[int, Deformation],
) -> tuple[Seam, ...]:
    """Seams of those pairs of sub-map ids that have common anchors."""
    found = (
        seam_between(tables[a], tables[b], T_w_s[a], T_w_s[b], deformations[a], deformations[b])
        for a, b in pairs
    )
    return tuple(seam for seam in found if seam is not None)
