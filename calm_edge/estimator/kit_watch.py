"""Detect that the kit changes during a drive, e.g. that a mount slips.

Windows after it do not fit the belief: most are refused, or give no evidence. So such a window is
solved with the rig free. If several in a row so contradict the belief on the rig, and none fits it,
the kit has changed; one alone may be a bad window. Focal lengths are not compared: a lens does not
change while driving, and several straight windows err alike in the focal.
"""

from __future__ import annotations

from dataclasses import dataclass

from calm_edge.kit import change
from calm_edge.kit.belief import product
from calm_edge.types import Hints, KitBelief, Prediction

# p-value of a part of the kit below which a window contradicts the belief.
CONTRADICTS = 0.01
# Windows in a row that are to contradict it together, at least and at most.
FEWEST, MOST = 2, 4


@dataclass(frozen=True, slots=True)
class Suspect:
    """A window solved with the rig free; `prediction` holds evidence."""

    submap_id: int
    t_ns: int
    prediction: Prediction
    hints: Hints


@dataclass(frozen=True, slots=True)
class Slip:
    """A change of the kit before the first of the suspects.

    text: what has changed. carried: belief of before on what has not changed.
    """

    suspects: tuple[Suspect, ...]
    text: str
    carried: KitBelief


class KitWatch:
    """The newest windows in a row that contradict the belief on the kit."""

    def __init__(self) -> None:
        self._suspects: list[Suspect] = []

    @staticmethod
    def fits(belief: KitBelief | None, prediction: Prediction) -> bool:
        """Whether a window fits the evidence of those before it."""
        if prediction.kit is None:
            return False
        if belief is None:
            return True
        return min(part.p_value for part in _of_rig(belief, prediction.kit)) > CONTRADICTS

    def acquit(self) -> None:
        """A window fits the belief: those before it were bad windows."""
        self._suspects.clear()

    def suspect(self, suspect: Suspect, belief: KitBelief) -> Slip | None:
        """Add a window that contradicts the belief; return the change once it is certain."""
        self._suspects = [*self._suspects, suspect][-MOST:]
        evidence = product([each.prediction.kit for each in self._suspects])
        if len(self._suspects) < FEWEST or evidence is None:
            return None
        text = ", ".join(part.text for part in _of_rig(belief, evidence) if part.noticed)
        if not text:
            return None
        slip = Slip(tuple(self._suspects), text, change.without_rig(belief))
        self._suspects = []
        return slip


def _of_rig(belief: KitBelief, evidence: KitBelief) -> tuple[change.Change, ...]:
    """Changes of the assistant's rotation and of its direction beyond their usual drift."""
    return change.changes(change.faded(belief), evidence)[2:]
