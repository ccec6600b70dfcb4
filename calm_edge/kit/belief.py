"""Fusion of independent beliefs on one kit: products of Gaussians in information form."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from calm_edge.types import Float, KitBelief

# Eigenvalues below this share of the largest, of the scaled information, count as zero.
_UNKNOWN = 1e-12


def product(beliefs: Iterable[KitBelief | None]) -> KitBelief | None:
    """Multiply independent beliefs: informations add, and so do informations times means.

    None entries are skipped; returns None if there are no others. Informations may be singular:
    along directions in which all are zero the first belief's mean is kept. Raises ValueError if
    they differ in size.
    """
    known = [belief for belief in beliefs if belief is not None]
    if not known:
        return None
    if len({belief.mean.shape for belief in known}) > 1:
        raise ValueError("kit beliefs differ in their number of entries")
    first = known[0].mean
    informations = np.stack([belief.information for belief in known])
    offsets = np.stack([belief.mean for belief in known]) - first
    information = informations.sum(0)
    step = _solve(information, (informations @ offsets[..., None])[..., 0].sum(0))
    return KitBelief(mean=first + step, information=information)


def _solve(A: Float, y: Float) -> Float:
    """Solve A x = y by the pseudo-inverse, A symmetric positive semidefinite.

    A is first scaled to unit diagonal, since its rows have different units.
    """
    diagonal = np.diag(A)
    unit = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(A * unit[:, None] * unit)
    known = values > _UNKNOWN * max(values[-1], 0.0)
    inverse = np.where(known, 1 / np.where(known, values, 1.0), 0.0)
    return np.asarray(unit * (vectors @ (inverse * (vectors.T @ (unit * y)))))
