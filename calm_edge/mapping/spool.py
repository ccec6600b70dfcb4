"""Depth, confidence and colour of every sub-map, on disk until the map is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.mapping.views import MappingError
from calm_edge.types import Bytes, Float32, Int


@dataclass(frozen=True, slots=True)
class SpooledDepth:
    """depth: (N, h, w) raw unit. confidence: (N, h, w) 255ths. image_size: (N, 2) px, (w, h)."""

    depth: Float32
    confidence: Bytes
    image_size: Int


class Spool:
    """One npz a sub-map in `folder`: 8 bytes a depth pixel. The caller removes the folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def write(
        self,
        submap_id: int,
        depth: Float32,
        confidence: Float32,
        images: Sequence[NDArray[np.uint8]],
    ) -> None:
        """depth, confidence (N, h, w); images: N of (H, W, 3) BGR, kept at the depth's size.

        Raises MappingError when the numbers differ or the disk refuses.
        """
        import cv2

        if len(images) != len(depth):
            raise MappingError(
                f"sub-map {submap_id}: {len(depth)} depth maps but {len(images)} images"
            )
        size = depth.shape[2], depth.shape[1]
        small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images]
        try:
            np.savez(
                self._path(submap_id),
                depth=depth.astype(np.float32),
                # rounded down, so that a pixel at the threshold stays below it
                confidence=(np.clip(confidence, 0, 1) * 255 + 1e-3).astype(np.uint8),
                color=np.stack(small)[..., ::-1],
                image_size=np.array([image.shape[1::-1] for image in images], np.int64),
            )
        except OSError as error:
            raise MappingError(f"{self._folder}: cannot spool depth ({error.strerror})") from None

    def depth(self, submap_id: int) -> SpooledDepth:
        """What `write` was given, confidence in 255ths; raises MappingError."""
        with self._open(submap_id) as arrays:
            return SpooledDepth(arrays["depth"], arrays["confidence"], arrays["image_size"])

    def color(self, submap_id: int) -> Bytes:
        """(N, h, w, 3) RGB at the depth's size; raises MappingError."""
        with self._open(submap_id) as arrays:
            return np.asarray(arrays["color"])

    def _path(self, submap_id: int) -> Path:
        return self._folder / f"submap{submap_id:06d}.npz"

    def _open(self, submap_id: int) -> np.lib.npyio.NpzFile:
        path = self._path(submap_id)
        try:
            return np.load(path, allow_pickle=False)  # type: ignore[no-any-return]
        except OSError as error:
            raise MappingError(f"{path}: spooled depth cannot be read ({error})") from None
