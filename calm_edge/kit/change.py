"""What an earlier drive taught of a kit, and whether this drive still fits it.

A remembered belief fades (`faded`) by what a kit does between two drives on its own: it warms, it
is refocused, it gets knocks. What moved further than that is noticed (`changes`): a bumped mount
turns the rig, another lens changes a focal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.types import Float, KitBelief

# One sigma of what happens between two drives without anyone having touched the kit.
# Log focal: temperature and refocusing, and what the pinhole model leaves out on another road.
FOCAL_FADES = 0.015
# Share of the image width: a lens shifts in its mount by some pixels.
CENTRE_FADES = 0.003
# Radial term, as its prior counts it.
RADIAL_FADES = 0.0001
# Radians, 0.3 degrees: doors, bumps in the road, a windscreen that warms.
RIG_ROTATION_FADES = 0.005
# Spacings: 5 mm of cameras half a metre apart.
RIG_PLACE_FADES = 0.01
# An entry of any other kind, such as an offset of clocks [s], is a matter of its own drive.
OTHERS_FADE = 1.0

# How often one of the four parts of an unmoved kit is said to have moved.
FALSE_ALARM = 1e-3
# A direction counts as observed where its sigma is below this share of what is known beforehand.
_OBSERVED_SHARE = 0.5
# Directions weaker than this share of the strongest are rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, slots=True)
class Change:
    """How far one part of the kit is from what was remembered of it.

    distance2: squared Mahalanobis distance over the `observed` directions that both beliefs know,
    chi-square with as many degrees of freedom while nothing moved. p_value: how often an unmoved
    kit is that far off. text: the move in words, of its observed directions.
    """

    text: str
    distance2: float
    observed: int
    p_value: float

    @property
    def noticed(self) -> bool:
        return self.p_value < FALSE_ALARM


def faded(belief: KitBelief) -> KitBelief:
    """The belief as the next drive may hold it: its covariance plus what happens in between.

    (Lambda^-1 + Q)^-1, written so that Lambda may be singular. Raises ValueError on a layout that
    is none of a kit.
    """
    _check(belief)
    sigma = np.full(layout.SIZE, OTHERS_FADE)
    for optics in layout.OPTICS:
        sigma[optics] = [FOCAL_FADES, CENTRE_FADES, CENTRE_FADES, RADIAL_FADES]
    sigma[layout.RIG] = np.repeat([RIG_ROTATION_FADES, RIG_PLACE_FADES], 3)
    values, vectors = np.linalg.eigh(belief.information * sigma[:, None] * sigma)
    values = np.maximum(values, 0)
    kept = (vectors * (values / (1 + values))) @ vectors.T
    return KitBelief(mean=belief.mean, information=kept / sigma[:, None] / sigma)


def changes(remembered: KitBelief, evidence: KitBelief) -> tuple[Change, ...]:
    """The focals of both eyes, then the rotation and the place of the assistant, each on its own.

    remembered: faded. evidence: of this drive alone. What is true of any camera bounds its centre
    and distortion, without which no short drive would tell its focal. Raises ValueError on a layout
    that is none of a kit.
    """
    bounds = _bounds()
    remembered, evidence = (_bounded(belief, bounds) for belief in (remembered, evidence))
    axes = np.eye(layout.SIZE)
    out = []
    for eye, index in zip(("primary", "assistant"), layout.LOG_FOCAL, strict=True):
        moved, change = _part(remembered, evidence, axes[:, [index]], layout.LOG_FOCAL_SIGMA)
        percent = 100 * np.expm1(moved.sum())
        out.append(_change(f"focal of the {eye} camera {percent:+.1f} %", change))
    rotation, place = axes[:, layout.RIG][:, :3], axes[:, layout.RIG][:, 3:]
    moved, change = _part(remembered, evidence, rotation, layout.RIG_ROTATION_SIGMA_RAD)
    turned = np.degrees(np.linalg.norm(moved))
    out.append(_change(f"assistant turned by {turned:.1f} deg", change))
    # its distance is the unit of all lengths: only the direction to it can be seen to change
    direction = remembered.mean[layout.RIG][3:]
    sideways = np.linalg.svd(direction[None])[2][1:].T
    moved, change = _part(remembered, evidence, place @ sideways, layout.RIG_DIRECTION_SIGMA)
    swung = np.degrees(np.arctan2(np.linalg.norm(moved), np.linalg.norm(direction)))
    out.append(_change(f"assistant's place swung round by {swung:.1f} deg", change))
    return tuple(out)


def _check(belief: KitBelief) -> None:
    if belief.mean.shape != (layout.SIZE,):
        raise ValueError(f"a belief of {len(belief.mean)} entries is none of a kit")


def _bounds() -> KitBelief:
    """The prior of a kit, of the entries that are no part of what may be said to have moved."""
    prior = layout.prior((None, None))
    information = np.diag(prior.information).copy()
    information[list(layout.LOG_FOCAL)] = 0
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
    remembered: KitBelief, evidence: KitBelief, axes: Float, known_beforehand: float
) -> tuple[Float, tuple[float, int]]:
    """The difference along `axes` (D, k), orthonormal: its observed share (k,); distance2, rank.

    The information of a difference is the parallel sum A (A + B)^+ B of the marginals', zero
    along what either does not know. known_beforehand: one sigma of the prior.
    """
    scale = known_beforehand
    A, B = (_marginal(b.information, axes) * scale**2 for b in (remembered, evidence))
    information = A @ np.linalg.pinv(A + B, rcond=_ROUNDING, hermitian=True) @ B
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    observed = values > _OBSERVED_SHARE**-2
    along = vectors[:, observed].T @ (axes.T @ (evidence.mean - remembered.mean)) / scale
    distance2 = float((values[observed] * along**2).sum())
    return np.asarray(vectors[:, observed] @ along * scale), (distance2, int(observed.sum()))


def _marginal(information: Float, axes: Float) -> Float:
    """The information (k, k) on `axes` (D, k) alone, everything else unknown: Schur complement."""
    others = np.linalg.svd(axes)[0][:, axes.shape[1] :]
    diagonal = np.diag(others.T @ information @ others)
    unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    others = others * unit
    mixed = axes.T @ information @ others
    inner = np.linalg.pinv(others.T @ information @ others, rcond=_ROUNDING, hermitian=True)
    return np.asarray(axes.T @ information @ axes - mixed @ inner @ mixed.T)
