"""How far apart two sub-maps put the same anchor, before and after the deformation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.mapping.deform import Deformation
from calm_edge.types import AnchorTable, Float


@dataclass(frozen=True, slots=True)
class Seam:
    """Two sub-maps with n_anchors in common; before, after: RMS distances, world units."""

    submap_a: int
    submap_b: int
    n_anchors: int
    before: float
    after: float


def seam_between(
    rows_a: AnchorTable,
    rows_b: AnchorTable,
    T_w_a: Float,
    T_w_b: Float,
    deform_a: Deformation,
    deform_b: Deformation,
) -> Seam | None:
    """The seam of two sub-maps (rows of one sub-map each), over every anchor in both.

    Suppressed anchors and those that are no control points count too. None without a shared one.
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
        len(shared),
        float(np.sqrt((before**2).sum(1).mean())),
        float(np.sqrt((after**2).sum(1).mean())),
    )


def seams(
    pairs: Iterable[tuple[int, int]],
    tables: Mapping[int, AnchorTable],
    T_w_s: Mapping[int, Float],
    deformations: Mapping[int, Deformation],
) -> tuple[Seam, ...]:
    """The seams of pairs of sub-map ids that have an anchor in common."""
    found = (
        seam_between(tables[a], tables[b], T_w_s[a], T_w_s[b], deformations[a], deformations[b])
        for a, b in pairs
    )
    return tuple(seam for seam in found if seam is not None)
