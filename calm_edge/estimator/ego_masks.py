"""Masks of both eyes over a drive: given, or learned from its windows and remembered."""

from __future__ import annotations

from collections.abc import Sequence

from calm_edge.estimator import ego_evidence
from calm_edge.geometry.camera import Camera
from calm_edge.kit.ego_mask import EgoMask, remembered
from calm_edge.types import Bytes, Float, Int, Masks

TOO_LARGE = (
    "more of the {} camera's picture seems attached to the car than a bonnet hides: all of it is "
    "used; give a mask (capture.mask) if that is wrong"
)
EYES = ("primary", "assistant")


class EgoMasks:
    """Learns what is attached to the car in each eye's pictures.

    given: masks of the configuration, which are used instead.
    """

    def __init__(self, given: Masks) -> None:
        self._given = given
        self._learned = (EgoMask(), EgoMask())
        self._restored = Masks()
        self._newest = -1

    @property
    def masks(self) -> Masks | None:
        """What is left out of the pictures, as known now; None if nothing is."""
        found = [self._of_eye(eye) for eye in (0, 1)]
        return None if found[0] is None and found[1] is None else Masks(*found)

    @property
    def log_odds(self) -> tuple[Float | None, Float | None]:
        """What is to be remembered of each eye, see `kit.ego_mask.EgoMask`."""
        return self._learned[0].log_odds, self._learned[1].log_odds

    @property
    def notices(self) -> tuple[str, ...]:
        """Lines for the user."""
        return tuple(
            TOO_LARGE.format(name)
            for eye, name in enumerate(EYES)
            if self._given.of_eye(eye) is None and self._learned[eye].too_large
        )

    def remember(self, log_odds: Sequence[Float | None]) -> None:
        """Begin with log odds of an earlier drive, None for an eye without; only before `add`."""
        for learned, known in zip(self._learned, log_odds, strict=True):
            if known is not None and self._newest < 0:
                learned.log_odds = remembered(known)

    def restore(self, masks: Masks | None) -> None:
        """Use the masks of the newest window that was solved earlier, instead of learning."""
        self._restored = masks or Masks()

    def add(
        self,
        submap_id: int,
        images: Sequence[Bytes],
        eyes: Int,
        cameras: Sequence[Camera],
        T_s_c: Float,
    ) -> None:
        """Learn from a solved window, see `ego_evidence.of_window`; from each window once."""
        if submap_id <= self._newest:
            return
        self._newest = submap_id
        found = ego_evidence.of_window(images, eyes, cameras, T_s_c)
        for learned, evidence in zip(self._learned, found, strict=True):
            if evidence is not None:
                learned.add(evidence)

    def _of_eye(self, eye: int) -> Bytes | None:
        for masks in (self._given, self._restored):
            if (mask := masks.of_eye(eye)) is not None:
                return mask
        return self._learned[eye].cells
