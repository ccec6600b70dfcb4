"""Detect that a kit has changed since an earlier drive, by chi-square tests on two beliefs.

An untouched kit drifts between two drives by temperature, refocusing and vibration. `faded` adds
that drift to an earlier drive's covariance; a larger difference is a change (`changes`): another
lens, a moved mount, or cameras that are swapped (`described`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.belief import gaussian, product
from calm_edge.kit.swap import swapped
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
    belief = gaussian(belief)
    sigma = layout.drift_sigma()
    values, vectors = np.linalg.eigh(belief.information * sigma[:, None] * sigma)
    values = np.maximum(values, 0)
    kept = (vectors * (values / (1 + values))) @ vectors.T
    return KitBelief(mean=belief.mean, information=kept / sigma[:, None] / sigma)


def without_rig(belief: KitBelief) -> KitBelief:
    """The belief on all but the rig, which is marginalised out; nothing is known of the rig."""
    _check(belief)
    rig = np.zeros(layout.SIZE, bool)
    rig[layout.RIG] = True
    others = np.eye(layout.SIZE)[:, ~rig]
    belief = gaussian(belief)
    information = others @ marginal(belief.information, others) @ others.T
    return KitBelief(belief.mean.copy(), information)


def described(remembered: KitBelief, evidence: KitBelief) -> tuple[str, ...]:
    """Describe what has changed, one line a part; empty if nothing has.

    remembered, evidence: as of `changes`. The cameras count as swapped if the direction of the
    assistant contradicts the memory, and nothing contradicts that of a swapped pair.
    """
    compared = changes(remembered, evidence)
    place = compared[-1]
    if place.noticed and not any(c.noticed for c in changes(swapped(remembered), evidence)):
        return ("the cameras are swapped",)
    return tuple(change.text for change in compared if change.noticed)


def changes(remembered: KitBelief, evidence: KitBelief) -> tuple[Change, ...]:
    """Test the focal of each eye, the assistant's rotation and its direction separately.

    remembered: of earlier drives, faded. evidence: of this drive alone. Both are multiplied by the
    prior (kit/layout) on principal points and distortion: without it a short drive leaves the focal
    undetermined. Raises ValueError if a belief has not layout.SIZE entries.
    """
    remembered, evidence = (bounded(belief) for belief in (remembered, evidence))
    axes = np.eye(layout.SIZE)
    out = []
    other = [other_family(remembered, evidence, eye) for eye in (0, 1)]
    for eye, index, replaced in zip(("primary", "assistant"), layout.LOG_FOCAL, other, strict=True):
        if replaced:
            out.append(another_lens(eye))
            continue
        moved, change = _part(remembered, evidence, axes[:, [index]], layout.LOG_FOCAL_SIGMA)
        percent = 100 * np.expm1(moved.sum())
        out.append(change_of(f"another lens on the {eye} camera, focal {percent:+.1f} %", change))
    rotation = axes[:, layout.RIG_ROTATION]
    moved, change = _part(remembered, evidence, rotation, layout.RIG_ROTATION_SIGMA_RAD)
    turned = np.degrees(np.linalg.norm(moved))
    out.append(change_of(f"the assistant has moved, turned by {turned:.1f} deg", change))
    moved, change = _direction(remembered, evidence)
    swung = np.degrees(np.linalg.norm(moved))
    out.append(change_of(f"the assistant has moved by {swung:.1f} deg around the primary", change))
    return tuple(out)


def other_family(one: KitBelief, other: KitBelief, eye: int) -> bool:
    """Whether both beliefs know the lens of an eye, and its families differ."""
    known = layout.of_lens(one)[eye] and layout.of_lens(other)[eye]
    return known and layout.families(one.mean)[eye] is not layout.families(other.mean)[eye]


def another_lens(eye: str) -> Change:
    """The change to a lens of another family."""
    return Change(f"another lens on the {eye} camera", np.inf, 1, 0.0)


def _check(belief: KitBelief) -> None:
    if belief.mean.shape != (layout.SIZE,):
        raise ValueError(f"a kit belief has {layout.SIZE} entries, not {len(belief.mean)}")


def bounded(belief: KitBelief) -> KitBelief:
    """Multiply by the prior on the parts that are not tested; ValueError for another size."""
    _check(belief)
    prior = layout.prior((None, None), families=layout.families(belief.mean))
    information = prior.information.copy()
    for tested in (layout.LOG_FOCAL, layout.RIG):
        information[tested] = 0
        information[:, tested] = 0
    joint = product([belief, KitBelief(mean=prior.mean, information=information)])
    assert joint is not None
    return gaussian(joint)


def change_of(text: str, part: tuple[float, int]) -> Change:
    """The change of a part from the distance2 and rank of `compared`."""
    distance2, observed = part
    p_value = float(chdtrc(observed, distance2)) if observed else 1.0
    return Change(text, distance2, observed, p_value)


def _part(
    remembered: KitBelief, evidence: KitBelief, axes: Float, prior_sigma: float
) -> tuple[Float, tuple[float, int]]:
    """`compared` along k orthonormal `axes` (D, k). prior_sigma: sigma of these in the prior."""
    A, B = (marginal(belief.information, axes) for belief in (remembered, evidence))
    return compared(axes.T @ (evidence.mean - remembered.mean), A, B, prior_sigma)


def _direction(remembered: KitBelief, evidence: KitBelief) -> tuple[Float, tuple[float, int]]:
    """Compare the directions of the assistant on the unit sphere, see `compared`.

    The spacing is the unit of all lengths, so only the direction can change. The difference is the
    arc between the two, in the tangent plane of the remembered one; the evidence's information is
    carried there along the arc, so that the test also holds for large angles.
    """
    place = np.eye(layout.SIZE)[:, layout.RIG_CENTRE]
    length = [float(np.linalg.norm(b.mean[layout.RIG_CENTRE])) for b in (remembered, evidence)]
    if min(length) == 0:
        return np.zeros(2), (0.0, 0)
    before, after = (
        belief.mean[layout.RIG_CENTRE] / norm
        for belief, norm in zip((remembered, evidence), length, strict=True)
    )
    tangent = np.linalg.svd(before[None])[2][1:].T
    normal = np.cross(before, after)
    sine = float(np.linalg.norm(normal))
    # opposite directions: any great circle joins them
    normal = normal / sine if sine > _ROUNDING else tangent[:, 0]
    angle = float(np.arctan2(sine, before @ after))
    carried = se3.so3_exp(angle * normal) @ tangent
    A, B = (
        marginal(belief.information, place @ basis) * norm**2
        for belief, basis, norm in zip(
            (remembered, evidence), (tangent, carried), length, strict=True
        )
    )
    arc = angle * np.cross(normal, before)
    return compared(tangent.T @ arc, A, B, layout.RIG_DIRECTION_SIGMA)


def compared(
    difference: Float, A: Float, B: Float, prior_sigma: float
) -> tuple[Float, tuple[float, int]]:
    """Return the observed part of a difference (k,), and (distance2, rank).

    The information of a difference is the parallel sum A (A + B)^+ B of the marginal informations A
    and B (k, k) of the two beliefs, zero along directions undetermined in either (Anderson and
    Duffin, Series and Parallel Addition of Matrices, 1969). prior_sigma: sigma of these terms in
    the prior, relative to which a direction counts as observed.
    """
    A, B = A * prior_sigma**2, B * prior_sigma**2
    information = A @ np.linalg.pinv(A + B, rcond=_ROUNDING, hermitian=True) @ B
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    observed = values > _OBSERVED_SHARE**-2
    along = vectors[:, observed].T @ difference / prior_sigma
    distance2 = float((values[observed] * along**2).sum())
    return np.asarray(vectors[:, observed] @ along * prior_sigma), (distance2, int(observed.sum()))


def marginal(information: Float, axes: Float) -> Float:
    """Information (k, k) on `axes` (D, k), the rest marginalised out by its Schur complement."""
    others = np.linalg.svd(axes)[0][:, axes.shape[1] :]
    diagonal = np.diag(others.T @ information @ others)
    unit = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    others = others * unit
    mixed = axes.T @ information @ others
    inner = np.linalg.pinv(others.T @ information @ others, rcond=_ROUNDING, hermitian=True)
    return np.asarray(axes.T @ information @ axes - mixed @ inner @ mixed.T)
