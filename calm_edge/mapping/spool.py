"""Scratch files with depth, confidence and colour of the sub-maps, until the map is written."""

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
    """Depth of a sub-map. depth: (N, h, w) raw unit. confidence: (N, h, w) in 1/255.

    image_size: (N, 2) width, height of the full images, px; of a view without image, that of its
    depth.
    """

    depth: Float32
    confidence: Bytes
    image_size: Int


class Spool:
    """One .npz file per sub-map in `folder`, 8 bytes per depth pixel; the caller removes it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def write(
        self,
        submap_id: int,
        depth: Float32,
        confidence: Float32,
        images: Sequence[NDArray[np.uint8] | None],
    ) -> None:
        """Write depth and confidence (N, h, w), and N BGR images resized to (h, w).

        An image may be None if its view has no depth; its colours are then black.

        Raises MappingError if the numbers of views differ or the file cannot be written.
        """
        import cv2

        if len(images) != len(depth):
            raise MappingError(
                f"sub-map {submap_id}: {len(depth)} depth maps but {len(images)} images; "
                "run calm-edge map again"
            )
        size = depth.shape[2], depth.shape[1]
        small = np.zeros((*depth.shape, 3), np.uint8)
        sizes = np.full((len(depth), 2), size)
        for view, image in enumerate(images):
            if image is not None:
                small[view] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
                sizes[view] = image.shape[1::-1]
        try:
            # renamed once complete: an interrupted `map` finds whole files only
            part = self._path(submap_id).with_suffix(".part")
            with part.open("wb") as file:
                np.savez(
                    file,
                    depth=depth.astype(np.float32),
                    # round down, so that a confidence below the threshold stays below it
                    confidence=(np.clip(confidence, 0, 1) * 255 + 1e-3).astype(np.uint8),
                    color=small[..., ::-1],
                    image_size=sizes.astype(np.int64),
                )
            part.replace(self._path(submap_id))
        except OSError as error:
            raise MappingError(
                f"{self._folder}: cannot write depth ({error.strerror}); check the disk"
            ) from None

    def holds(self, submap_id: int) -> bool:
        """Whether the depth of a sub-map has been written."""
        return self._path(submap_id).exists()

    def depth(self, submap_id: int) -> SpooledDepth:
        """Read depth and confidence of a sub-map. Raises MappingError."""
        with self._open(submap_id) as arrays:
            return SpooledDepth(arrays["depth"], arrays["confidence"], arrays["image_size"])

    def color(self, submap_id: int) -> Bytes:
        """Read colours (N, h, w, 3), RGB, at the size of the depth maps. Raises MappingError."""
        with self._open(submap_id) as arrays:
            return np.asarray(arrays["color"])

    def _path(self, submap_id: int) -> Path:
        return self._folder / f"submap{submap_id:06d}.npz"

    def _open(self, submap_id: int) -> np.lib.npyio.NpzFile:
        path = self._path(submap_id)
        try:
            return np.load(path, allow_pickle=False)  # type: ignore[no-any-return]
        except OSError as error:
            raise MappingError(
                f"{path}: scratch file cannot be read ({error}); run calm-edge map again"
            ) from None
