"""Run a feed-forward graph on a batch of images and decode its outputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.decoder import Decoded, decode
from calm_edge.backbones.onnx.manifest import Manifest, Precision
from calm_edge.backbones.onnx.picture_input import Fit, input_tensor
from calm_edge.backbones.onnx.session import Session, Tensor
from calm_edge.types import Bytes


class Network:
    """A loaded model of kind `feedforward`; stateless."""

    def __init__(self, manifest: Manifest, precision: Precision) -> None:
        """Load the graph. Raises BackboneError."""
        if manifest.output is None:
            raise BackboneError(f"{manifest.name}: is of kind {manifest.kind}, not feedforward")
        self._spec, self._outputs, self._frames = manifest.input, manifest.output, manifest.frames
        graph = manifest.graphs["model"]
        self._session = Session(
            manifest.graph_path("model", precision),
            needs_inputs=[manifest.input.name, *graph.inputs],
            needs_outputs=[*self._outputs.names(), *graph.outputs],
        )

    def raw(self, images: Sequence[Bytes], fits: Sequence[Fit]) -> dict[str, Tensor]:
        """Output tensors needed for decoding, by name. Raises BackboneError.

        images: (H, W, 3) uint8 BGR, a number that the graph accepts.
        """
        tensor = input_tensor(self._spec, images, fits)
        return self._session.run({self._spec.name: tensor}, self._outputs.names())

    def solve(self, images: Sequence[Bytes], fits: Sequence[Fit]) -> Decoded:
        """Run and decode images, at most the graph's maximum. Raises BackboneError.

        If the graph needs more images, the last one is repeated and the repetitions dropped.
        """
        n, frames = len(images), self._frames
        filled = max(n, frames.min)
        index = np.minimum(np.arange(filled), n - 1)
        fits = [fits[i] for i in index]
        raw = self.raw([images[i] for i in index], fits)
        decoded = decode(self._outputs, raw, fits)
        if filled == n:
            return decoded
        return replace(
            decoded,
            cameras=decoded.cameras[:n],
            T_s_c=decoded.T_s_c[:n],
            depth=decoded.depth[:n],
            strength=decoded.strength[:n],
        )
