"""A textured parallelogram, and its texture at every pair of resolutions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.synthetic.textures import Image

Float = NDArray[np.float64]


@dataclass(slots=True)
class Texture:
    """An image painted when first seen, with area-filtered copies halved along either axis.

    Axes are halved apart, so that a road seen at a grazing angle is neither blurred nor aliased.
    """

    paint: Callable[[], Image]
    _levels: dict[tuple[int, int], Image] = field(default_factory=dict)

    def base(self) -> Image:
        """The full-resolution image."""
        if (0, 0) not in self._levels:
            self._levels[0, 0] = np.ascontiguousarray(self.paint())
        return self._levels[0, 0]

    def level(self, lx: int, ly: int) -> Image:
        """The image with its width halved lx times and its height ly times (at least 1 px)."""
        if (lx, ly) not in self._levels:
            h, w = self.base().shape[:2]
            size = (max(1, round(w / 2**lx)), max(1, round(h / 2**ly)))
            small = cv2.resize(self.base(), size, interpolation=cv2.INTER_AREA)
            self._levels[lx, ly] = np.asarray(small, np.uint8)
        return self._levels[lx, ly]


@dataclass(frozen=True, slots=True)
class Surface:
    """Points origin + u * along + v * down, u and v in [0, 1]; metres, world frame.

    Seen from its front, `along` points right and `down` down. two_sided: also drawn from behind.
    """

    origin: Float
    along: Float
    down: Float
    texture: Texture
    two_sided: bool = False


UP = np.array([0.0, -1.0, 0.0])


def wall(
    left: Float, right: Float, height: float, texture: Texture, *, two_sided: bool = False
) -> Surface:
    """A vertical surface standing on the segment left -> right, as seen from its front."""
    return Surface(left + height * UP, right - left, -height * UP, texture, two_sided)


def box(
    corner: Float, along: Float, inward: Float, height: float, textures: dict[str, Texture]
) -> list[Surface]:
    """An upright box: `corner` its front left foot, `along` its front, `inward` its depth.

    textures: any of front, left, right, back, top, bottom; missing faces are not made.
    """
    a, b = corner, corner + along
    c, d = b + inward, a + inward
    faces = {"front": (a, b), "right": (b, c), "back": (c, d), "left": (d, a)}
    out = [wall(*faces[k], height, textures[k]) for k in faces if k in textures]
    if "top" in textures:
        out.append(Surface(d + height * UP, along, -inward, textures["top"]))
    if "bottom" in textures:
        out.append(Surface(a, along, inward, textures["bottom"]))
    return out
