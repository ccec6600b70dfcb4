"""A known calibration during a drive: used while the drive agrees with it."""

from __future__ import annotations

import numpy as np

from calm_edge.config import CalibrationConfig
from calm_edge.kit import change, layout
from calm_edge.kit.belief import gaussian, product
from calm_edge.kit.calibration import EYES, optics_belief, rig_belief
from calm_edge.types import Int, KitBelief

# Comparisons that agree before the rig is used: windows solved under a wrong rig reproduce it.
RIG_TRUSTED_AFTER = 3
# Comparisons in a row that contradict a part before it is dropped: one window may be bad.
DROPPED_AFTER = 2
# Directions of the optics count as observed where their sigma is below half of this multiple of the
# prior's, which is that of usual lenses.
WIDER = 4.0


class CalibratedKit:
    """Optics of each eye, used at once, and the rig, used once windows agree with it.

    Each of these parts is compared with the evidence of the drive, and dropped by itself: a bumped
    mount leaves the lenses as they are. The constructor raises ConfigError.
    """

    def __init__(self, config: CalibrationConfig) -> None:
        self._config = config
        self._optics: KitBelief | None = None
        self._rig = rig_belief(config)
        self._compared = 0
        self._contradicted = np.zeros(4, int)
        self._lines: tuple[str, ...] = ()

    @property
    def belief(self) -> KitBelief | None:
        """Prior of the parts that are used at present."""
        trusted = self._compared >= RIG_TRUSTED_AFTER
        return product([self._optics, self._rig if trusted else None])

    def open(self, sizes: Int) -> None:
        """Convert the calibration to pictures of sizes (2, 2) [px]."""
        self._optics, lines = optics_belief(self._config, sizes)
        self._lines = tuple(lines)

    def contradicted(self, evidence: KitBelief | None) -> tuple[str, ...]:
        """Compare with the evidence of this drive; lines for each part that does not hold."""
        lines, self._lines = self._lines, ()
        known = product([self._optics, self._rig])
        if known is None or evidence is None:
            return lines
        known = change.faded(known)
        # parts: the lens of each eye, both lenses together, the rig
        lenses = [lens_change(known, evidence, eye) for eye in (0, 1)]
        ratio = ratio_change(known, evidence)
        rig = [part for part in change.changes(known, evidence)[2:] if part.noticed]
        either = any(part.noticed for part in lenses)
        noticed = [*(part.noticed for part in lenses), ratio.noticed and not either, bool(rig)]
        self._contradicted = np.where(noticed, self._contradicted + 1, 0)
        self._compared += not rig
        dropped = self._contradicted >= DROPPED_AFTER
        self._contradicted[dropped] = 0
        for eye in (0, 1):
            if dropped[eye] or dropped[2]:
                self._optics = _without_optics(self._optics, eye)
        if dropped[3]:
            self._rig = None
        texts = [part.text for part, gone in zip([*lenses, ratio], dropped, strict=False) if gone]
        texts += [part.text for part in rig if dropped[3]]
        held = "the calibration does not hold"
        return (*lines, *(f"{held}: {text}; it is learned from driving" for text in texts))

    def after_change(self, *, lens: bool) -> KitBelief | None:
        """Drop what does not hold after a change of the kit during the drive; return the rest.

        lens: a lens has changed, not only a mount.
        """
        self._rig = None
        if lens:
            self._optics = None
        return self._optics


def lens_change(known: KitBelief, evidence: KitBelief, eye: int) -> change.Change:
    """Compare all terms of an eye's optics, along the directions that both know."""
    if change.other_family(known, evidence, eye):
        return change.another_lens(EYES[eye])
    terms = layout.OPTICS[eye]
    axes = np.eye(layout.SIZE)[:, terms]
    usual = layout.prior((None, None), families=layout.families(known.mean))
    sigma = WIDER * np.sqrt(np.diag(np.linalg.inv(usual.information)))[terms]
    difference = (evidence.mean - known.mean)[terms] / sigma
    A, B = (
        change.marginal(gaussian(each).information, axes) * np.outer(sigma, sigma)
        for each in (known, evidence)
    )
    moved, part = change.compared(difference, A, B, 1.0)
    percent = 100 * np.expm1(moved[0] * sigma[0])
    text = f"another lens on the {EYES[eye]} camera, focal {percent:+.1f} %"
    return change.change_of(text, part)


def ratio_change(known: KitBelief, evidence: KitBelief) -> change.Change:
    """Compare the ratio of the focal lengths, which evidence shows better than either of them."""
    axis = np.zeros((layout.SIZE, 1))
    axis[layout.LOG_FOCAL, 0] = np.sqrt([0.5, 0.5]) * [1, -1]
    A, B = (change.marginal(gaussian(each).information, axis) for each in (known, evidence))
    moved, part = change.compared(
        axis.T @ (evidence.mean - known.mean), A, B, layout.LOG_FOCAL_SIGMA
    )
    percent = 100 * np.expm1(np.sqrt(2.0) * moved.sum())
    text = (
        f"another lens on one of the cameras, the ratio of their focals is off by {percent:+.1f} %"
    )
    return change.change_of(text, part)


def _without_optics(belief: KitBelief | None, eye: int) -> KitBelief | None:
    """The belief without the terms of an eye; None if nothing is left."""
    if belief is None:
        return None
    information = belief.information.copy()
    terms = np.r_[layout.OPTICS[eye], layout.FAMILY[eye]]
    information[terms] = 0
    information[:, terms] = 0
    return KitBelief(belief.mean, information) if information.any() else None
