"""Interfaces of the methods compared: matchers and depth makers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera
from calm_edge.types import Bytes, Float, Float32, Int


@dataclass(frozen=True, slots=True)
class Matches:
    """Positions of N query points in the other picture.

    uv_b: (N, 2) px, undefined where not found. found: (N,). sigma_px: (N,) sigma per image axis,
    NaN if the matcher gives none.
    """

    uv_b: Float
    found: NDArray[np.bool_]
    sigma_px: Float


class Matcher(Protocol):
    """Finds given points of one picture in another one; deterministic."""

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """Find the points query_uv (N, 2) px of image_a in image_b.

        Pictures (H, W, 3) BGR; they may differ in size.
        """
        ...


class DepthMaker(Protocol):
    """Computes the depth of one of several posed pictures."""

    def depth(
        self,
        images: Sequence[Bytes],
        cameras: Sequence[Camera],
        T_w_c: Float,
        eyes: Int,
        reference: int,
    ) -> tuple[Float32, Float32]:
        """Compute z-depth (h, w) and confidence (h, w) of the picture `reference`.

        Depth is in the poses' unit, 0 if unknown; a larger confidence is better. h, w may be
        smaller than the picture; pixel centres scale as in cv2.resize. images: N pictures (H, W, 3)
        BGR, those of one eye in order of time, then those of the other. cameras: N. T_w_c: (N, 4,
        4). eyes: (N,).
        """
        ...
