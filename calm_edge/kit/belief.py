"""Fusion of independent beliefs on one kit: products of Gaussians in information form."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from calm_edge.types import Float, KitBelief

# Eigenvalues below this share of the largest, of the scaled information, count as zero.
_UNKNOWN = 1e-12
# Added to the noise, as a share of the information: regular where the noise is singular.
_NOISE_FLOOR = 1e-3


def product(beliefs: Iterable[KitBelief | None]) -> KitBelief | None:
    """Multiply independent beliefs: informations add, and so do informations times means.

    Their noises add too, and so do their common errors, which therefore never average out. None
    entries are skipped; returns None if there are no others.

    Informations may be singular: along directions in which all are zero the first belief's mean is
    kept. Raises ValueError if they differ in size.
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
    step = _pseudo_inverse(information) @ (informations @ offsets[..., None])[..., 0].sum(0)
    noise, measured = None, None
    if any(belief.noise is not None for belief in known):
        noise = np.sum([noise_of(belief) for belief in known], axis=0)
    parts = [belief.measured for belief in known if belief.measured is not None]
    if parts:
        measured = np.sum(parts, axis=0)
    common = sum(belief.common for belief in known)
    return KitBelief(first + step, information, noise, measured, common)


def noise_of(belief: KitBelief) -> Float:
    """Covariance (D, D) of information times error, without the common error."""
    return belief.information if belief.noise is None else belief.noise


def _total_noise(belief: KitBelief) -> Float:
    noise = noise_of(belief)
    return noise if belief.measured is None else noise + belief.common * belief.measured


def covariance(belief: KitBelief) -> Float:
    """Covariance (D, D) of the mean's error; 0 along directions without information."""
    inverse = _pseudo_inverse(belief.information)
    return np.asarray(inverse @ _total_noise(belief) @ inverse)


def sigmas(belief: KitBelief) -> Float:
    """Sigmas (D,) of the mean's error; 0 where `covariance` is 0."""
    return np.asarray(np.sqrt(np.diag(covariance(belief))))


def gaussian(belief: KitBelief) -> KitBelief:
    """The belief with the inverse of its `covariance` as information, and no noise of its own."""
    if belief.noise is None and belief.measured is None:
        return belief
    Lambda = belief.information
    inner = _pseudo_inverse(_total_noise(belief) + _NOISE_FLOOR * Lambda)
    return KitBelief(belief.mean, Lambda @ inner @ Lambda)


def blurred(belief: KitBelief, direction: Float, sigma: float) -> KitBelief:
    """Add the variance sigma^2 along `direction` (D,), in information form (Sherman-Morrison)."""
    column = belief.information @ direction
    length2 = float(direction @ column)
    if sigma <= 0 or length2 <= 0:
        return belief
    known = length2 + sigma**-2
    information = belief.information - np.outer(column, column) / known
    if belief.noise is None:
        return replace(belief, information=information)
    weaker = np.eye(len(column)) - np.outer(column, direction) / known
    left = sigma * (information @ direction)
    noise = weaker @ belief.noise @ weaker.T + np.outer(left, left)
    measured = None if belief.measured is None else weaker @ belief.measured @ weaker.T
    return replace(belief, information=information, noise=noise, measured=measured)


def scaled(belief: KitBelief, share: float) -> KitBelief:
    """Weigh a belief less: its weight is `share` of what it was, its covariance as before."""
    return KitBelief(
        belief.mean,
        share * belief.information,
        share**2 * noise_of(belief),
        None if belief.measured is None else share * belief.measured,
        share * belief.common,
    )


def _pseudo_inverse(A: Float) -> Float:
    """Pseudo-inverse of A (D, D), symmetric positive semidefinite.

    A is first scaled to unit diagonal, since its rows have different units.
    """
    diagonal = np.diag(A)
    unit = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(A * unit[:, None] * unit)
    known = values > _UNKNOWN * max(values[-1], 0.0)
    inverse = np.where(known, 1 / np.where(known, values, 1.0), 0.0)
    return np.asarray(unit[:, None] * ((vectors * inverse) @ vectors.T) * unit)
