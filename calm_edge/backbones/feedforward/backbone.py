"""Backbone that runs a published visual geometry model (VGFM, paper III) from a model folder."""

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
    """A feed-forward network as backbone; stateless.

    Windows with more than `max_views` views are split with overlap and stitched.
    """

    def __init__(
        self,
        manifest: Manifest,
        precision: Precision,
        max_views: int,
        notices: tuple[str, ...] = (),
    ) -> None:
        """max_views: maximum per run, >= 2. notices: lines added to each prediction.

        File hashes are not verified here. Raises BackboneError.
        """
        if max_views < 2:
            raise BackboneError(
                f"{manifest.name}: runs one view at a time, which gives no relative poses; "
                "use another model"
            )
        self._manifest, self._notices, self._max_views = manifest, notices, max_views
        self._network = Network(manifest, precision)

    @classmethod
    def from_config(cls, config: Config) -> FeedforwardBackbone:
        """Open `feedforward:NAME_OR_FOLDER`, or a model by its name alone.

        Raises BackboneError if the folder is damaged or `model check` has refused it here.
        """
        if not model_of(config):
            raise BackboneError("backbone.name = 'feedforward': add a model, feedforward:NAME")
        model = opened(config)
        views = most_views(model.manifest, model.precision, config.backbone.max_views)
        return cls(model.manifest, model.precision, views, model.notices)

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Reconstruct a window, see Backbone.infer; the result always has depth and confidence."""
        n = len(images)
        if n == 0:
            raise BackboneError(f"{self._manifest.name}: a window without images")
        fits = fit_pictures(self._manifest.input, [(i.shape[1], i.shape[0]) for i in images])
        if n <= self._max_views:
            return prediction(self._network.solve(images, fits), fits, self._notices)
        parts = self._parts(images, hints)
        solved = [self._part(images, fits, part) for part in parts]
        notice = (
            f"{self._manifest.name} takes {self._max_views} views: longer windows are solved in "
            "overlapping parts and stitched"
        )
        whole = window_parts.stitch(n, parts, solved)
        return prediction(whole, fits, (*self._notices, notice))

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """Add depth, see Backbone.densify; runs the network again if `prediction` has none."""
        if prediction.depth is not None:
            return prediction
        again = self.infer(images, hints)
        return replace(prediction, depth=again.depth, confidence=again.confidence)

    def _part(self, images: Sequence[Bytes], fits: Sequence[Fit], part: Int) -> Decoded:
        return self._network.solve([images[i] for i in part], [fits[i] for i in part])

    def _parts(self, images: Sequence[Bytes], hints: Hints) -> list[Int]:
        """Split the window: batch indices of each part. A loop keyframe gets an extra part, with
        the views around the one most similar to it.
        """
        if not hints.loop:
            return window_parts.split(hints.t_ns, self._max_views)
        window = hints.without_loop()
        t_ns = window.t_ns
        parts = window_parts.split(t_ns, self._max_views)
        layout = GradientLayout()
        primary = np.flatnonzero(window.eyes == Eye.PRIMARY).tolist()
        described = np.stack([layout.describe(images[i]) for i in primary])
        likeness = layout.similarity(layout.describe(images[-1])[None], described)[0]
        alike = primary[int(likeness.argmax())]
        near = window_parts.around(t_ns, alike, self._max_views)
        return [*parts, np.append(near, len(t_ns))]
