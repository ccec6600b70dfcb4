"""Backbone that computes predictions from ground truth with configured errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.scripted.batch import Batch
from bench.scripted.errors import Errors, ScriptedErrors
from bench.scripted.scene import ScriptedScene, read_scene
from calm_edge.backbones.base import BackboneError
from calm_edge.config import Config
from calm_edge.types import Float32, Hints, Int, Prediction


class ScriptedBackbone:
    """Predictions of a scene under errors. Ignores images; all draws are seeded by the stamps."""

    def __init__(self, scene: ScriptedScene, errors: ScriptedErrors | None = None) -> None:
        self._scene = scene
        self._errors = Errors(errors or ScriptedErrors(), scene.t_ns, scene.T_w_p)

    @classmethod
    def from_config(cls, config: Config) -> ScriptedBackbone:
        """Open `scripted:FOLDER` with poses0.txt and, if present, times0.txt and calib.txt.

        Rig: T_p_a.txt (12 numbers, a KITTI row), or one unit to the right. Raises BackboneError.
        """
        folder = config.backbone.name.partition(":")[2]
        if not folder:
            raise BackboneError("backbone.name = 'scripted': name a folder, scripted:FOLDER")
        scene = read_scene(Path(folder), config)
        return cls(scene, ScriptedErrors(seed=config.backbone.seed))

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Poses, cameras and landmarks, without depth; raises BackboneError."""
        return Batch(self._scene, self._errors, hints).prediction()

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """Add depth at 1 / DEPTH_STRIDE of the image size, and confidence."""
        if prediction.depth is not None:
            return prediction
        depth, confidence = self.depth(hints, np.arange(len(hints.t_ns)))
        return replace(prediction, depth=depth, confidence=confidence)

    def depth(self, hints: Hints, views: Int) -> tuple[Float32, Float32]:
        """Depth and confidence (V, h, w) of some views of a batch, as `densify` gives them."""
        return Batch(self._scene, self._errors, hints).depth(views)
