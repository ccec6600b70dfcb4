"""Backbone that computes its predictions from ground truth, with configured errors."""

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
    """Backbone with scripted predictions of a scene.

    It ignores the images. All random values are seeded by the stamps.
    """

    def __init__(self, scene: ScriptedScene, errors: ScriptedErrors | None = None) -> None:
        self._scene = scene
        self._errors = Errors(errors or ScriptedErrors(), scene.t_ns, scene.T_w_p)

    @classmethod
    def from_config(cls, config: Config) -> ScriptedBackbone:
        """Read the ground truth in FOLDER of `scripted:FOLDER`; raises BackboneError.

        Files: poses0.txt and, if present, times0.txt, calib.txt, and T_p_a.txt for the rig (12
        numbers, a KITTI row). Without the latter the assistant is one unit to the right.
        """
        folder = config.backbone.name.partition(":")[2]
        if not folder:
            raise BackboneError("backbone.name = 'scripted': no folder; give scripted:FOLDER")
        scene = read_scene(Path(folder), config)
        return cls(scene, ScriptedErrors(seed=config.backbone.seed))

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Compute poses, cameras and landmarks of a batch, without depth; raises BackboneError."""
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
        """Depth and confidence (V, h, w) of the views with these indices, as in `densify`."""
        return Batch(self._scene, self._errors, hints).depth(views)
