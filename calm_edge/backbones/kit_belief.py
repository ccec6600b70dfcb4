"""What windows teach of one kit adds up: products of Gaussians in information form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calm_edge.types import Float, KitBelief

# Below this share of the best-known (scaled) direction, a direction counts as unknown.
_UNKNOWN = 1e-12


def combine(a: KitBelief | None, b: KitBelief | None) -> KitBelief | None:
    """The product of two beliefs; None knows nothing. Otherwise as `product`."""
    return product([belief for belief in (a, b) if belief is not None])


def product(beliefs: Sequence[KitBelief]) -> KitBelief | None:
    """The product of independent beliefs: informations add, the mean solves; None of none.

    Any of them may be singular. Along directions that none knows the mean is the first one's.
    Raises ValueError when they differ in layout.
    """
    if not beliefs:
        return None
    if len({belief.mean.shape for belief in beliefs}) > 1:
        raise ValueError("beliefs of different kits: their layouts differ")
    first = beliefs[0].mean
    informations = np.stack([belief.information for belief in beliefs])
    offsets = np.stack([belief.mean for belief in beliefs]) - first
    information = informations.sum(0)
    step = _solve(information, (informations @ offsets[..., None])[..., 0].sum(0))
    return KitBelief(mean=first + step, information=information)


def _solve(A: Float, y: Float) -> Float:
    """A^+ y of a symmetric positive semidefinite A whose rows differ in unit."""
    diagonal = np.diag(A)
    unit = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(A * unit[:, None] * unit)
    known = values > _UNKNOWN * max(values[-1], 0.0)
    inverse = np.where(known, 1 / np.where(known, values, 1.0), 0.0)
    return np.asarray(unit * (vectors @ (inverse * (vectors.T @ (unit * y)))))
