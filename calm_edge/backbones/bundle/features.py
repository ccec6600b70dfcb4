"""Learned encoder for matching and place recognition, run once for each picture.

It has its own threads: the pictures of a window are encoded while the first ones are matched.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from calm_edge.backbones.onnx.manifest import Manifest, ManifestError, Precision
from calm_edge.backbones.onnx.picture_input import Fit, fit_pictures, input_tensor
from calm_edge.backbones.onnx.session import Session
from calm_edge.config import BackboneConfig, Config
from calm_edge.geometry.flow import Gray
from calm_edge.types import Bytes, Float32

# Number of pictures in the cache. Windows overlap, so pictures are used again.
KEPT = 64
# Number of pictures encoded in parallel.
ENCODERS = 2


@dataclass(frozen=True, slots=True)
class Features:
    """Feature maps of one picture, at 1/8 (h8, w8) and 1/4 (h4, w4) of the network's input size.

    Cell k of a map is centred on (k + 0.5) * stride - 0.5 px of the input, with a stride of 8 or 4.
    fit: transform from picture to input. coarse: (h8, w8, 64) and fine: (h4, w4, 32), of unit
    length in each cell. reliability: (h8, w8) in [0, 1]. place: global descriptor (256,) of unit
    length.
    """

    fit: Fit
    coarse: Float32
    reliability: Float32
    fine: Float32
    place: Float32

    def to_input(self, uv: Float32) -> Float32:
        """Convert (N, 2) px of the picture to px of the input."""
        scale = np.array(self.fit.scale, np.float32)
        return np.asarray((uv + 0.5) * scale - 0.5, np.float32)

    def to_picture(self, uv: Float32) -> Float32:
        """Convert (N, 2) px of the input to px of the picture."""
        scale = np.array(self.fit.scale, np.float32)
        return np.asarray((uv + 0.5) / scale - 0.5, np.float32)

    @property
    def pixel(self) -> float:
        """Size of an input pixel in picture pixels, the mean of both axes."""
        return 2 / sum(self.fit.scale)


class FeatureNet:
    """Runs a model's graphs `encoder`, for features of a picture, and `refine`, for matches.

    The model is of kind bundle. Features of recent pictures are cached. Thread-safe.
    """

    def __init__(self, manifest: Manifest, precision: Precision) -> None:
        """Load the graphs of a model; raises BackboneError."""
        missing = [role for role in ("encoder", "refine") if role not in manifest.graphs]
        if missing:
            raise ManifestError(f"{manifest.name}: bundle needs the graph {missing[0]}")
        self._spec = manifest.input
        encoder, refine = manifest.graphs["encoder"], manifest.graphs["refine"]
        self._encoder = Session(
            manifest.graph_path("encoder", precision),
            needs_inputs=[self._spec.name, *encoder.inputs],
            needs_outputs=["coarse", "reliability", "fine", "place", *encoder.outputs],
        )
        self._refine = Session(
            manifest.graph_path("refine", precision),
            needs_inputs=["there", "here", *refine.inputs],
            needs_outputs=["offset", "sigma", *refine.outputs],
        )
        self._kept: OrderedDict[tuple[Any, ...], Future[Features]] = OrderedDict()
        self._keeping = threading.Lock()
        self._beside = ThreadPoolExecutor(ENCODERS, "encoder")

    @classmethod
    def of_model(cls, name: str, precision: Precision | None = None) -> FeatureNet:
        """Open a model, by default in the precision measured best on this machine.

        Raises BackboneError.
        """
        from calm_edge.backbones.onnx.precision import opened

        config = BackboneConfig(name=f"bundle:{name}", precision=precision or "auto")
        model = opened(Config(backbone=config))
        return cls(model.manifest, model.precision)

    def of(self, pictures: Sequence[Bytes | Gray]) -> list[Features]:
        """Features of (H, W, 3) BGR or (H, W) grey pictures; raises BackboneError."""
        return [encoded.result() for encoded in self.begin(pictures)]

    def begin(self, pictures: Sequence[Bytes | Gray]) -> list[Future[Features]]:
        """Start encoding pictures in other threads; return a future for each."""
        return [self._begin(picture) for picture in pictures]

    def _begin(self, picture: Bytes | Gray) -> Future[Features]:
        gray = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        gray = np.ascontiguousarray(gray)
        key = (gray.shape, hash(gray.tobytes()))
        with self._keeping:
            known = self._kept.get(key)
            if known is None:
                known = self._beside.submit(self._encoded, np.asarray(gray, np.uint8))
                self._kept[key] = known
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            else:
                self._kept.move_to_end(key)
        return known

    def _encoded(self, gray: Gray) -> Features:
        height, width = gray.shape
        (fit,) = fit_pictures(self._spec, [(width, height)])
        colours = np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)
        out = self._encoder.run({self._spec.name: input_tensor(self._spec, [colours], [fit])})
        return Features(
            fit,
            np.ascontiguousarray(out["coarse"][0].transpose(1, 2, 0), np.float32),
            np.asarray(out["reliability"][0, 0], np.float32),
            np.ascontiguousarray(out["fine"][0].transpose(1, 2, 0), np.float32),
            np.asarray(out["place"][0], np.float32),
        )

    def refined(self, there: Float32, here: Float32) -> tuple[Float32, Float32]:
        """Refine guessed matches: offset (N, 2) to add, and sigma (N,), px of the network's input.

        there: (N, 81) correlations of each point's feature with the cells around its guess in the
        other picture; here: with those around the point itself (`correspond.correlations`). Raises
        BackboneError.
        """
        out = self._refine.run({"there": there, "here": here})
        return np.asarray(out["offset"], np.float32), np.asarray(out["sigma"], np.float32)
