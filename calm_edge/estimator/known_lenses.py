"""Lenses of a drive by which pictures are undistorted, for a backbone of pinhole cameras.

They are those of a calibration, else of the kit file of earlier drives, else of `bundle`, which
solves the first windows with a turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from calm_edge.backbones.base import Backbone, BackboneError
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config
from calm_edge.correction.intrinsic_search import LENS_MOVED_PX
from calm_edge.estimator.kit_memory import teaches
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.through_lens import lens_moved_px
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.kit.calibration import EYES
from calm_edge.kit.known_lens import calibrated_lens, learned_lens
from calm_edge.kit.prior import KitPrior
from calm_edge.types import Bytes, Float, Hints, Int, KitBelief, Prediction
from device.frame import Eye

# Rotation of the primary within a window from which on it counts as a turn, and such windows that
# `bundle` solves: on a straight road the bend of the picture looks like another focal length.
TURN_RAD = np.radians(10.0)
MOST_WINDOWS = 8

UNKNOWN = "the lens of the {} is not known yet: the model gets the pictures as they are"
KNOWN = "the pictures of the {} are undistorted, by the lens of {}"

Lenses = tuple[Camera | None, Camera | None]


class KnownLenses:
    """Lens of each eye, None while it is not known well enough; see `kit/known_lens`."""

    def __init__(self, config: Config, kit_prior: KitPrior) -> None:
        self._config, self._prior = config, kit_prior
        self._bundle: Backbone | None = None
        self._tried = 0
        # of the windows that `bundle` has solved
        self.evidence: KitBelief | None = None
        self._lenses: list[Camera | None] = [None, None]
        self._sources = ["", ""]
        self._opened = False

    @property
    def notices(self) -> tuple[str, ...]:
        """Lines for the user: whose pictures are undistorted, and the source of the lens."""
        if not self._opened:
            return ()
        eyes = dict[str, list[str]]()
        for eye, source in zip(EYES, self._sources, strict=True):
            eyes.setdefault(source, []).append(eye)
        return tuple(
            KNOWN.format(" and the ".join(names), source)
            if source
            else UNKNOWN.format(" and the ".join(names))
            for source, names in eyes.items()
        )

    def of(self, sizes: Int | None) -> Lenses:
        """Lens of each eye for pictures of these sizes (2, 2) [px], after `KitPrior.open`."""
        if sizes is None:
            return None, None
        self._opened = True
        for eye in Eye:
            self._look_up(eye, *sizes[eye].tolist())
        return self._lenses[Eye.PRIMARY], self._lenses[Eye.ASSISTANT]

    def learn(self, images: Sequence[Bytes], hints: Hints, prediction: Prediction) -> None:
        """Solve a window by `bundle` as well, if it has a turn and a lens is not calibrated.

        images, hints, prediction: of the window as the drive's backbone solved it.
        """
        calibrated = all(source == "the calibration" for source in self._sources)
        if calibrated or self._tried == MOST_WINDOWS or not _turns(hints, prediction):
            return
        if self._bundle is None:
            backbone = replace(self._config.backbone, name="bundle")
            self._bundle = open_backbone(replace(self._config, backbone=backbone))
        if hints.loop:
            images, hints = images[:-1], hints.without_loop()
        hints = replace(hints.without_neighbours(), kit=self.evidence, n_overlap=0, n_shared=0)
        self._tried += 1
        with suppress(BackboneError):
            solved = self._bundle.infer(images, hints)
            if solved.kit is not None and teaches(solved):
                self.evidence = _added(self.evidence, solved.kit)

    def _look_up(self, eye: Eye, width: int, height: int) -> None:
        """Look for the lens of an eye; one that has hardly moved is kept."""
        found = [
            ("the calibration", calibrated_lens(self._config.calibration, eye, width, height)),
            ("earlier drives", learned_lens(self._prior.earlier, eye, width, height)),
            ("the first turns", learned_lens(self.evidence, eye, width, height)),
        ]
        source, lens = next(((s, lens) for s, lens in found if lens is not None), ("", None))
        if lens is None or lens_moved_px(self._lenses[eye], lens) > LENS_MOVED_PX:
            self._lenses[eye], self._sources[eye] = lens, source


def _added(evidence: KitBelief | None, window: KitBelief) -> KitBelief:
    """Product of evidence; that of other families of lenses is replaced by the newer one."""
    if evidence is None or not layout.alike(evidence, window):
        return window
    both = product([evidence, window])
    assert both is not None
    return both


def _turns(hints: Hints, prediction: Prediction) -> bool:
    """Whether the primary turns within a window that shows both eyes."""
    primary = np.flatnonzero(hints.eyes == Eye.PRIMARY)
    primary = primary[: len(primary) - hints.loop]
    if len(primary) < 2 or not (hints.eyes == Eye.ASSISTANT).any():
        return False
    R: Float = prediction.T_s_c[primary, :3, :3]
    turned = se3.so3_log(np.swapaxes(R[:1], 1, 2) @ R)
    return bool(np.linalg.norm(turned, axis=1).max() > TURN_RAD)
