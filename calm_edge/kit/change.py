"""Detect that a kit has changed since an earlier drive, by chi-square tests on two beliefs.

An untouched kit drifts between two drives by temperature, refocusing and vibration. `faded` adds
that drift to an earlier drive's covariance; a larger difference is a change (`changes`), such as
a turned mount or another lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.types import Float, KitBelief

# p-value below which a part counts as changed, which is the rate of false alarms per part
FALSE_ALARM = 1e-3
# A direction counts as observed where its sigma is below this share of the prior's.
_OBSERVED_SHARE = 0.5
# Eigenvalues of the information below this share of the largest count as rounding errors.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Change:
    """Difference of one part of the kit between this drive and earlier ones.

    distance2: squared Mahalanobis distance over the `observed` directions, those known to both
    beliefs; chi-square distributed with that many degrees of freedom if nothing changed. p_value:
    of that distance. text: description of the difference along the observed directions.
    """

    text: str
    distance2: float
    observed: int
    p_value: float

    @property
    def noticed(self) -> bool:
        return self.p_value < FALSE_ALARM


def faded(belief: KitBelief) -> KitBelief:
    """Add the drift between two drives to the belief's covariance.

    The information Lambda becomes (Lambda^-1 + Q)^-1, with Q the covariance of the drift, written
    so that Lambda may be singular. Raises ValueError if the belief has not layout.SIZE entries.
    """
    _check(belief)
    sigma = layout.drift_sigma()
    values, vectors = np.linalg.eigh(belief.information * sigma[:, None] * sigma)
    values = np.maximum(values, 0)
    kept = (vectors * (values / (1 + values))) @ vectors.T
    return KitBelief(mean=belief.mean, information=kept / sigma[:, None] / sigma)


def changes(remembered: KitBelief, evidence: KitBelief) -> tuple[Change, ...]:
    """Test the focal of each eye, the assistant's rotation and its position separately.

    remembered: of earlier drives, faded. evidence: of this drive alone. Both are multiplied by the
    prior (kit/layout) on principal points and distortion: without it a short drive leaves the focal
    undetermined. Raises ValueError if a belief has not layout.SIZE entries.
    """
    bounds = _bounds()
    remembered, evidence = (_bounded(belief, bounds) for belief in (remembered, evidence))
    axes = np.eye(layout.SIZE)
    out = []
    for eye, index in zip(("primary", "assistant"), layout.LOG_FOCAL, strict=True):
        moved, change = _part(remembered, evidence, axes[:, [index]], layout.LOG_FOCAL_SIGMA)
        percent = 100 * np.expm1(moved.sum())
        out.append(_change(f"focal of the {eye} camera {percent:+.1f} %", change))
    rotation, place = axes[:, layout.RIG_ROTATION], axes[:, layout.RIG_CENTRE]
    moved, change = _part(remembered, evidence, rotation, layout.RIG_ROTATION_SIGMA_RAD)
    turned = np.degrees(np.linalg.norm(moved))
    out.append(_change(f"assistant turned by {turned:.1f} deg", change))
    # the spacing is the unit of all lengths: only the direction of the assistant can change
    direction = remembered.mean[layout.RIG_CENTRE]
    sideways = np.linalg.svd(direction[None])[2][1:].T
    moved, change = _part(remembered, evidence, place @ sideways, layout.RIG_DIRECTION_SIGMA)
    swung = np.degrees(np.arctan2(np.linalg.norm(moved), np.linalg.norm(direction)))
    out.append(_change(f"assistant moved by {swung:.1f} deg around the primary", change))
    return tuple(out)


def _check(belief: KitBelief) -> None:
    if belief.mean.shape != (layout.SIZE,):
        raise ValueError(f"a kit belief has {layout.SIZE} entries, not {len(belief.mean)}")


def _bounds() -> KitBelief:
    """Return the prior of a kit without information on the parts that are tested."""
    prior = layout.prior((None, None))
    information = np.diag(prior.information).copy()
    information[layout.LOG_FOCAL] = 0
    information[layout.RIG] = 0
    return KitBelief(mean=prior.mean, information=np.diag(information))


def _bounded(belief: KitBelief, bounds: KitBelief) -> KitBelief:
    _check(belief)
    joint = product([belief, bounds])
    assert joint is not None
    return joint


def _change(text: str, part: tuple[float, int]) -> Change:
    distance2, observed = part
    p_value = float(chdtrc(observed, distance2)) if observed else 1.0
    return Change(text, distance2, observed, p_value)


def _part(
    remembered: KitBelief, evidence: KitBelief, axes: Float, prior_sigma: float
) -> tuple[Float, tuple[float, int]]:
    """Return the observed difference (k,) along k orthonormal `axes` (D, k), and (distance2, rank).

    The information of a difference is the parallel sum A (A + B)^+ B of the marginal informations A
    and B of the two beliefs, zero along directions undetermined in either (Anderson and Duffin,
    Series and Parallel Addition of Matrices, 1969). prior_sigma: sigma of these terms in the prior,
    relative to which a direction counts as observed.
    """
    A, B = (_marginal(b.information, axes) * prior_sigma**2 for b in (remembered, evidence))
    information = A @ np.linalg.pinv(A + B, rcond=_ROUNDING, hermitian=True) @ B
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    observed = values > _OBSERVED_SHARE**-2
    along = vectors[:, observed].T @ (axes.T @ (evidence.mean - remembered.mean)) / prior_sigma
    distance2 = float((values[observed] * along**2).sum())
    return np.asarray(vectors[:, observed] @ along * prior_sigma), (distance2, int(observed.sum()))


def _marginal(information: Float, axes: Float) -> Float:
    """Information (k, k) on `axes` (D, k), the rest marginalised out by its Schur complement."""
    others = np.linalg.svd(axes)[0][:, axes.shape[1] :]
    diagonal = np.diag(others.T @ information @ others)
    unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    others = others * unit
    mixed = axes.T @ information @ others
    inner = np.linalg.pinv(others.T @ information @ others, rcond=_ROUNDING, hermitian=True)
    return np.asarray(axes.T @ information @ axes - mixed @ inner @ mixed.T)
