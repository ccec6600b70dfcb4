"""The feedforward backbone: any network of a model folder that answers in one pass (paper III)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward import window_parts
from calm_edge.backbones.feedforward.decode.decoder import Decoded, prediction
from calm_edge.backbones.feedforward.network import Network
from calm_edge.backbones.onnx.manifest import Manifest, Precision
from calm_edge.backbones.onnx.picture_input import Fit, fit_pictures
from calm_edge.backbones.onnx.precision import model_of, most_views, opened
from calm_edge.config import Config
from calm_edge.loops.descriptor import GradientLayout
from calm_edge.types import Bytes, Hints, Int, Prediction
from device.frame import Eye


class FeedforwardBackbone:
    """Stateless. Windows longer than `max_views` are split with overlap and stitched."""

    name = "feedforward"

    def __init__(
        self,
        manifest: Manifest,
        precision: Precision,
        max_views: int,
        notices: tuple[str, ...] = (),
    ) -> None:
        """max_views: >= 2, a run. notices: lines that every prediction brings. The files are not
        compared with their hashes. Raises BackboneError."""
        if max_views < 2:
            raise BackboneError(f"{manifest.name}: runs one view at a time: nothing ties poses")
        self._manifest, self._notices, self._max_views = manifest, notices, max_views
        self._network = Network(manifest, precision)

    @classmethod
    def from_config(cls, config: Config) -> FeedforwardBackbone:
        """`feedforward:NAME_OR_FOLDER`, or the bare name of a model; raises BackboneError.

        Refuses a folder that is damaged, or that `model check` refused on this machine.
        """
        if not model_of(config):
            raise BackboneError("backbone.name = 'feedforward': name a model, feedforward:NAME")
        model = opened(config)
        views = most_views(model.manifest, model.precision, config.backbone.max_views)
        return cls(model.manifest, model.precision, views, model.notices)

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Poses, K, depth and confidence; raises BackboneError."""
        n = len(images)
        if n == 0:
            raise BackboneError(f"{self._manifest.name}: a window without pictures")
        fits = fit_pictures(self._manifest.input, [(i.shape[1], i.shape[0]) for i in images])
        if n <= self._max_views:
            return prediction(self._network.solve(images, fits), fits, self._notices)
        parts = self._parts(images, hints)
        solved = [self._part(images, fits, part) for part in parts]
        notice = (
            f"{self._manifest.name} takes {self._max_views} views: windows that are longer are "
            "solved in parts, joined on the views they share"
        )
        whole = window_parts.stitch(n, parts, solved)
        return prediction(whole, fits, (*self._notices, notice))

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """The prediction with depth and confidence, inferred again where it has none."""
        if prediction.depth is not None:
            return prediction
        again = self.infer(images, hints)
        return replace(prediction, depth=again.depth, confidence=again.confidence)

    def _part(self, images: Sequence[Bytes], fits: Sequence[Fit], part: Int) -> Decoded:
        return self._network.solve([images[i] for i in part], [fits[i] for i in part])

    def _parts(self, images: Sequence[Bytes], hints: Hints) -> list[Int]:
        """Batch indices; a loop keyframe gets a part of its own, among the views most alike it."""
        if not hints.loop:
            return window_parts.split(hints.t_ns, self._max_views)
        t_ns = hints.t_ns[:-1]
        parts = window_parts.split(t_ns, self._max_views)
        layout = GradientLayout()
        primary = np.flatnonzero(hints.eyes[:-1] == Eye.PRIMARY).tolist()
        described = np.stack([layout.describe(images[i]) for i in primary])
        likeness = layout.similarity(layout.describe(images[-1])[None], described)[0]
        alike = primary[int(likeness.argmax())]
        near = window_parts.around(t_ns, alike, self._max_views)
        return [*parts, np.append(near, len(t_ns))]
