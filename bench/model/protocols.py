"""Protocols of the methods compared: matchers and depth makers."""

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

    uv_b: (N, 2) px, undefined where not found. found: (N,). sigma_px: (N,) one sigma per image
    axis, NaN where the matcher gives none.
    """

    uv_b: Float
    found: NDArray[np.bool_]
    sigma_px: Float


class Matcher(Protocol):
    """Finds given points of one picture in another; deterministic."""

    def match(self, image_a: Bytes, image_b: Bytes, query_uv: Float) -> Matches:
        """Match query_uv (N, 2) px of a. Pictures (H, W, 3) BGR may differ in size."""
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
        """z-depth (h, w), 0 unknown, in the poses' unit, and confidence (h, w), larger is better.

        images: N of (H, W, 3) BGR, of one eye in order of time, then of the other. cameras: N.
        T_w_c: (N, 4, 4). eyes: (N,). reference: index of the picture. h, w may be smaller than
        the picture; pixel centres scale as in cv2.resize.
        """
        ...
