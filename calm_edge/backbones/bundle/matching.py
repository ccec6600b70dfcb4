"""Matches between two pictures, and the protocol of learned matchers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.flow import Gray
from calm_edge.types import Float, Float32

Bool = NDArray[np.bool_]

# Sigma per axis of a corner tracked by Lucas-Kanade, drift along its track included.
FOLLOWED_PX = 0.5


@dataclass(frozen=True, slots=True)
class Matches:
    """Matches of N points. uv: (N, 2) px of the other picture. sigma_px: (N,) sigma per axis.

    sure: (N,) bool, forward and backward match agree. measured: (N,) bool, and the match was also
    refined by Lucas-Kanade.
    """

    uv: Float32
    sure: Bool
    sigma_px: Float32
    measured: Bool


class Matching(Protocol):
    """Interface of matchers that need no initial guess; thread-safe."""

    def expect(self, primary: list[Gray], assistant: list[Gray], H_a_p: Float | None) -> None:
        """Start work on pictures that will be matched. H_a_p: None if unknown."""
        ...

    def along(self, source: Gray, target: Gray, uv: Float32) -> Matches:
        """Match points uv (N, 2) px of a picture to a later one of the same camera."""
        ...

    def homography(self, primary: Gray, assistant: Gray) -> Float | None:
        """Rough H_a_p (3, 3) px, rotation and zoom between the cameras; None if not found."""
        ...

    def across(self, primary: Gray, assistant: Gray, H_a_p: Float, uv: Float32) -> Matches:
        """Match primary points uv (N, 2) px to the assistant's picture, given H_a_p."""
        ...
