"""Collect the evidence of all windows on the kit; solve windows again when the belief changes."""

from __future__ import annotations

import logging
from bisect import bisect_right
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.backbones.base import Backbone, BackboneError, ResolvingBackbone
from calm_edge.estimator.metre import UNKNOWN
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.polyline import path_length
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.types import Float, Hints, Int, KitBelief, Overlap, PathLength, Prediction

log = logging.getLogger(__name__)

# A window is solved again, which linearises its evidence anew, if the newest log focal length
# differs from the one with which the window was solved by more than this and by two sigmas.
FOCAL_MOVED = 0.02
MOVED_SIGMAS = 2.0
# Corrections of stamps that differ by less are the same.
SAME_INSTANT_S = 1e-3


@dataclass(frozen=True, slots=True)
class _Window:
    """A solved window.

    log_focal: (2,) log focal length in px of each camera, as solved; NaN for one without images.
    lenses: class of each camera.
    """

    prediction: Prediction
    hints: Hints
    log_focal: Float
    lenses: tuple[type[Camera], ...]


class KitMemory:
    """Collects the kit evidence of all windows; keeps the newest `limit` windows to solve again.

    prior: belief of earlier drives, or None. sizes: (2, 2) [px] of the newest window's pictures, or
    None. Windows are kept, without their depth, only if the
    backbone can solve them again (has `resolve`).
    """

    def __init__(self, backbone: Backbone, limit: int) -> None:
        self._backbone = backbone
        self._limit = limit
        self.prior: KitBelief | None = None
        self._evidence: dict[int, KitBelief] = {}
        self._total: KitBelief | None = None
        # epochs of the kit: the sub-map each begins with, and what it takes over from the last one
        self._begins: list[int] = [0]
        self._carried: list[KitBelief | None] = [None]
        self._windows: dict[int, _Window] = {}
        self.sizes: Int | None = None
        self._sized_by = -1

    def evidence(self, without: int | None = None) -> KitBelief | None:
        """Product of the evidence of the newest epoch of the kit.

        Or of that of sub-map `without`, except its own.
        """
        if without is None:
            return self._total
        epoch = self.epoch(without)
        if without not in self._evidence and epoch == self.epoch(None):
            return self._total
        return self._of_epoch(epoch, without)

    def belief(self, without: int | None = None) -> KitBelief | None:
        """Product of `evidence(without)` and of the prior, which holds for the first epoch."""
        prior = self.prior if self.epoch(without) == 0 else None
        evidence = self.evidence(without)
        if prior is not None and evidence is not None and not layout.alike(prior, evidence):
            prior = None
        return product([prior, evidence])

    def begin_epoch(self, submap_id: int, carried: KitBelief | None) -> None:
        """Collect the evidence from a sub-map on separately: the kit has changed before it.

        carried: what holds of the kit before; its evidence is no longer used.
        """
        self._begins.append(submap_id)
        self._carried.append(carried)
        self._total = self._of_epoch(self.epoch(None))

    def resized(self, submap_id: int, sizes: Int | None) -> bool:
        """Note the sizes (2, 2) [px] of a window's pictures; begin an epoch if they have changed.

        Only the newest window may do so. What was learned of the lenses holds for the former mode
        of the cameras. Returns whether an epoch has begun.
        """
        if sizes is None or submap_id < self._sized_by:
            return False
        changed = self.sizes is not None and not np.array_equal(sizes, self.sizes)
        self.sizes, self._sized_by = sizes, submap_id
        if changed:
            self.begin_epoch(submap_id, None)
        return changed

    def epoch(self, submap_id: int | None) -> int:
        """Number of the epoch of a sub-map, None for the newest one."""
        if submap_id is None:
            return len(self._begins) - 1
        return bisect_right(self._begins, submap_id) - 1

    def _of_epoch(self, epoch: int, without: int | None = None) -> KitBelief | None:
        own = [
            kit
            for key, kit in self._evidence.items()
            if key != without and self.epoch(key) == epoch
        ]
        carried = self._carried[epoch]
        own = own if carried is None else [carried, *own]
        # before the lenses' family is known; the newest window knows most
        return product([kit for kit in own if layout.alike(kit, own[-1])])

    def add(self, submap_id: int, prediction: Prediction, hints: Hints) -> None:
        """Collect the kit evidence of a solved window, and keep the window to solve it again.

        Replaces what is known of the window from an earlier solution.
        """
        if submap_id in self._evidence:
            del self._evidence[submap_id]
            self._total = self._of_epoch(self.epoch(None))
        if prediction.kit is not None and teaches(prediction):
            self._evidence[submap_id] = prediction.kit
            total, kit = self._total, prediction.kit
            if self.epoch(submap_id) == self.epoch(None):
                known = total is None or layout.alike(total, kit)
                self._total = product([total, kit]) if known else self._of_epoch(self.epoch(None))
        if not isinstance(self._backbone, ResolvingBackbone):
            return
        light = replace(prediction, depth=None, confidence=None)
        self._windows[submap_id] = _Window(
            light, hints, _log_focal(prediction, hints), _lenses(prediction)
        )
        while len(self._windows) > self._limit:
            del self._windows[min(self._windows)]

    def overlap_before(self, submap_id: int) -> Overlap | None:
        """Estimate, by the newest solution of the previous window, of the keyframes shared with it.

        None if there is no such window, or if it is of another epoch: its poses hold for its kit.
        """
        before = self._windows.get(submap_id - 1)
        if before is None or self.epoch(submap_id - 1) != self.epoch(submap_id):
            return None
        belief, own = self.belief(without=submap_id), before.prediction.kit
        if belief is not None and own is not None and not layout.alike(belief, own):
            return None
        return before.prediction.overlap

    def lengths_beside(self, submap_id: int, hints: Hints) -> tuple[PathLength, ...]:
        """Lengths of the paths that a window shares with its neighbours, by their newest solutions.

        Of the same epoch only: a rig that has moved has another spacing. hints: of the window.
        """
        found = []
        for other in (submap_id - 1, submap_id + 1):
            beside = self._windows.get(other)
            if beside is None or self.epoch(other) != self.epoch(submap_id):
                continue
            sigma, views = beside.prediction.scale_log_sigma, np.flatnonzero(beside.hints.eyes == 0)
            shared = views[np.isin(beside.hints.t_ns[views], hints.t_ns[hints.eyes == 0])]
            if sigma is None or sigma >= UNKNOWN or len(shared) < 2:
                continue
            length = path_length(beside.prediction.T_s_c[shared, :3, 3])
            if length > 0:
                found.append(PathLength(beside.hints.t_ns[shared], length, sigma))
        return tuple(found)

    def retained(self) -> list[int]:
        """Ids of the sub-maps that can be solved again."""
        return sorted(self._windows)

    def prediction(self, submap_id: int) -> Prediction | None:
        """Newest solution of a window, without depth; None if it is not retained."""
        window = self._windows.get(submap_id)
        return None if window is None else window.prediction

    def correct_stamps(self, late_s: Callable[[Hints], Float]) -> list[int]:
        """Give all windows the known offsets of their stamps; return ids of those this changes.

        late_s: gives `Hints.late_s`. Their evidence and overlap are dropped until they are solved
        again.
        """
        changed = []
        for submap_id, window in self._windows.items():
            late, before = late_s(window.hints), window.hints.late_s
            if np.abs(late - (0.0 if before is None else before)).max() > SAME_INSTANT_S:
                hints = replace(window.hints, late_s=late)
                prediction = replace(window.prediction, overlap=None)
                self._windows[submap_id] = replace(window, hints=hints, prediction=prediction)
                self._evidence.pop(submap_id, None)
                changed.append(submap_id)
        self._total = self._of_epoch(self.epoch(None))
        return sorted(changed)

    def outdated(self) -> list[int]:
        """Ids of sub-maps solved with another focal length than the newest window.

        That is, the log focal lengths of either camera differ by more than FOCAL_MOVED, and by
        MOVED_SIGMAS of the newest window, or the lenses are of other families.
        """
        if not self._windows:
            return []
        newest = self._windows[max(self._windows)]
        sigma = newest.prediction.focal_log_sigma
        if sigma is None:
            return []
        sigmas = [np.min(sigma[newest.hints.eyes == eye], initial=np.inf) for eye in (0, 1)]
        limit = np.maximum(MOVED_SIGMAS * np.array(sigmas), FOCAL_MOVED)
        return [
            submap_id
            for submap_id, window in sorted(self._windows.items())
            if self.epoch(submap_id) == self.epoch(None)
            and (
                newest.lenses != window.lenses
                or np.any(np.abs(newest.log_focal - window.log_focal) > limit)
            )
        ]

    def resolve(self, submap_ids: Iterable[int]) -> dict[int, Prediction]:
        """Solve windows again with the newest evidence of the others as prior; omits failures."""
        solved: dict[int, Prediction] = {}
        if not (self._windows and isinstance(self._backbone, ResolvingBackbone)):
            return solved
        newest = self._windows[max(self._windows)]
        for submap_id in submap_ids:
            window = self._windows[submap_id]
            hints = replace(
                window.hints,
                kit=self.belief(without=submap_id),
                overlap=self.overlap_before(submap_id),
                lengths=self.lengths_beside(submap_id, window.hints),
            )
            # also after a failure store the newest focal length and lenses, so that `outdated` does
            # not list the window again with the same belief
            prediction, log_focal, lenses = window.prediction, newest.log_focal, newest.lenses
            try:
                again = self._backbone.resolve(window.prediction, hints)
                if lost_scale(window.prediction, again):
                    raise BackboneError("solved again it shows no scale")
                prediction = solved[submap_id] = again
                log_focal, lenses = _log_focal(prediction, hints), _lenses(prediction)
                self._evidence.pop(submap_id, None)
                if prediction.kit is not None and teaches(prediction):
                    self._evidence[submap_id] = prediction.kit
            except BackboneError as error:
                log.warning("sub-map %d keeps its earlier solution: %s", submap_id, error)
            light = replace(prediction, depth=None, confidence=None)
            self._windows[submap_id] = _Window(light, hints, log_focal, lenses)
        self._total = self._of_epoch(self.epoch(None))
        return solved


def teaches(prediction: Prediction) -> bool:
    """Whether evidence on the kit may be taken from a solved window.

    Without parallax between the cameras there is none on the rig, and what the solver makes of it
    is noise.
    """
    sigma = prediction.scale_log_sigma
    return sigma is None or sigma < UNKNOWN


def lost_scale(before: Prediction, now: Prediction) -> bool:
    """Whether a window that is solved again shows no scale any more, which it did before."""
    return teaches(before) and not teaches(now)


def _lenses(prediction: Prediction) -> tuple[type[Camera], ...]:
    return tuple(dict.fromkeys(type(camera) for camera in prediction.cameras))


def _log_focal(prediction: Prediction, hints: Hints) -> Float:
    focals = np.log([camera.fx for camera in prediction.cameras])
    of_eye = [focals[hints.eyes == eye] for eye in (0, 1)]
    return np.array([f[0] if len(f) else np.nan for f in of_eye])
