"""What classical and learned matching share: a match, its noise, and the protocol of a matcher."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.flow import Gray
from calm_edge.types import Float, Float32

Bool = NDArray[np.bool_]

# What a followed corner is off by, an axis, drift along its track included.
FOLLOWED_PX = 0.5


@dataclass(frozen=True, slots=True)
class Found:
    """uv: (N, 2) px of the other picture, the best there is where not sure. sigma_px: (N,) an axis.

    sure: (N,) there and back agree. measured: (N,) on the pictures themselves as well, and both
    agree.
    """

    uv: Float32
    sure: Bool
    sigma_px: Float32
    measured: Bool


class Matching(Protocol):
    """Finds points without a guess, in place of Lucas-Kanade from one; from several threads."""

    def expect(self, primary: list[Gray], assistant: list[Gray], H_a_p: Float | None) -> None:
        """Pictures that will be asked for: what they need may begin. H_a_p: None if not known."""
        ...

    def along(self, source: Gray, target: Gray, uv: Float32) -> Found:
        """Points uv (N, 2) px of a picture in a later one of the same eye."""
        ...

    def homography(self, primary: Gray, assistant: Gray) -> Float | None:
        """Rough H_a_p (3, 3) px, the rotation and the zoom between the eyes; None where unsure."""
        ...

    def across(self, primary: Gray, assistant: Gray, H_a_p: Float, uv: Float32) -> Found:
        """Primary points uv (N, 2) px in the assistant's picture, which H_a_p makes alike."""
        ...
