"""What each window taught of the kit, and what it takes to solve it again once that is known."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.backbones.base import Backbone, BackboneError, ResolvingBackbone
from calm_edge.kit.belief import product
from calm_edge.types import Float, Hints, KitBelief, Prediction

log = logging.getLogger(__name__)

# A focal this far (log) from the one a window was solved with bends its motion visibly.
FOCAL_MOVED = 0.01


@dataclass(frozen=True, slots=True)
class _Window:
    """log_focal: (2,) an eye, as believed when it was last solved; nan for an absent eye."""

    prediction: Prediction
    hints: Hints
    log_focal: Float


class KitMemory:
    """Owns the kit evidence of every window, and the `limit` most recent windows themselves.

    remembered: of earlier drives, None for nothing. Windows are kept only for a backbone with
    `resolve`, and without their depth.
    """

    def __init__(self, backbone: Backbone, limit: int) -> None:
        self._backbone = backbone
        self._limit = limit
        self.remembered: KitBelief | None = None
        self._taught: dict[int, KitBelief] = {}
        self._together: KitBelief | None = None
        self._windows: dict[int, _Window] = {}

    def taught(self, without: int | None = None) -> KitBelief | None:
        """The product of what all windows taught, `without` one of them."""
        if without is None:
            return self._together
        return product([kit for key, kit in self._taught.items() if key != without])

    def belief(self, without: int | None = None) -> KitBelief | None:
        """That and what is remembered of earlier drives."""
        return product([self.remembered, self.taught(without)])

    def add(self, submap_id: int, prediction: Prediction, hints: Hints) -> None:
        """Takes in a window just solved."""
        if prediction.kit is not None:
            self._taught[submap_id] = prediction.kit
            self._together = product([self._together, prediction.kit])
        if not isinstance(self._backbone, ResolvingBackbone):
            return
        light = replace(prediction, depth=None, confidence=None)
        self._windows[submap_id] = _Window(light, hints, _log_focal(prediction, hints))
        while len(self._windows) > self._limit:
            del self._windows[next(iter(self._windows))]

    def retained(self) -> list[int]:
        """Sub-map ids that can be solved again."""
        return list(self._windows)

    def outdated(self) -> list[int]:
        """Sub-maps whose focal the newest window, solved last, is sure is wrong."""
        if not self._windows:
            return []
        newest = next(reversed(self._windows.values()))
        sigma = newest.prediction.focal_log_sigma
        if sigma is None:
            return []
        sure = np.array(
            [
                np.min(sigma[newest.hints.eyes == eye], initial=np.inf) < FOCAL_MOVED
                for eye in (0, 1)
            ]
        )
        return [
            submap_id
            for submap_id, window in self._windows.items()
            if np.any(sure & (np.abs(newest.log_focal - window.log_focal) > FOCAL_MOVED))
        ]

    def resolve(self, submap_ids: Iterable[int]) -> dict[int, Prediction]:
        """Solves windows again under what the others taught; those that fail are left out."""
        solved: dict[int, Prediction] = {}
        if not (self._windows and isinstance(self._backbone, ResolvingBackbone)):
            return solved
        believed = next(reversed(self._windows.values())).log_focal
        for submap_id in submap_ids:
            window = self._windows[submap_id]
            hints = replace(window.hints, kit=self.belief(without=submap_id))
            prediction = window.prediction
            try:
                prediction = self._backbone.resolve(window.prediction, hints)
                solved[submap_id] = prediction
            except BackboneError as error:
                log.warning("sub-map %d keeps its earlier solution: %s", submap_id, error)
            # solved or not, it need not be tried again until the belief moves on
            light = replace(prediction, depth=None, confidence=None)
            self._windows[submap_id] = _Window(light, hints, believed)
        for submap_id, prediction in solved.items():
            if prediction.kit is not None:
                self._taught[submap_id] = prediction.kit
        self._together = product(self._taught.values())
        return solved


def _log_focal(prediction: Prediction, hints: Hints) -> Float:
    focals = np.log([camera.fx for camera in prediction.cameras])
    of_eye = [focals[hints.eyes == eye] for eye in (0, 1)]
    return np.array([f[0] if len(f) else np.nan for f in of_eye])
