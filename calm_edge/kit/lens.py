"""Lens of an eye: one of two families of projections with two radial terms each.

In both the image radius is a factor times that of a pinhole camera, so they share their unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.distortion import radial
from calm_edge.geometry.fisheye import Fisheye, angle_radial, angle_terms
from calm_edge.types import Float

TERMS = 2


class Family(IntEnum):
    """Family of lenses. PERSPECTIVE: up to about 110 degrees. FISHEYE: wide lenses."""

    PERSPECTIVE = 0
    FISHEYE = 1


@dataclass(frozen=True, slots=True)
class Lens:
    """A family of lenses and its terms k1, k2, as of geometry/distortion or geometry/fisheye."""

    family: Family
    k: tuple[float, ...]

    def factor(self, s: Float) -> tuple[Float, Float]:
        """Image radius over that of a pinhole camera at squared radii s (N,) of normalised
        coordinates, and its derivative by s."""
        if self.family is Family.FISHEYE:
            return angle_radial(s, self.k)
        gain, slope = radial(s, self.k)
        return np.asarray(gain), np.asarray(slope)

    def terms(self, s: Float) -> Float:
        """Derivatives (TERMS, N) of the factor by the terms."""
        if self.family is Family.FISHEYE:
            return angle_terms(s, len(self.k))
        return np.stack([s ** (n + 1) for n in range(len(self.k))])

    def camera(self, f: float, cx: float, cy: float, width: int, height: int) -> Camera:
        """The camera of this lens; raises FieldTooWide (geometry/fisheye)."""
        kind = Fisheye if self.family is Family.FISHEYE else Perspective
        return kind(f, f, cx, cy, width, height, self.k)
