"""What every visual geometry model looks like to the rest of calm-edge (paper III)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from calm_edge.types import CalmEdgeError, Hints, Prediction


class BackboneError(CalmEdgeError):
    """The model cannot be loaded, or a batch cannot be reconstructed."""


class Backbone(Protocol):
    """N images -> intrinsics, poses, depth, confidence. Stateless: same input, same output."""

    name: str

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """(H, W, 3) uint8 BGR images in batch order -> Prediction; raises BackboneError.

        Depth may be left out (None) by models that solve poses first.
        """
        ...

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """The same prediction with depth and confidence; returned as is when it has them."""
        ...


@runtime_checkable
class ExpectsPictures(Protocol):
    """A backbone that may be able to begin on a picture before its window is whole."""

    @property
    def expects_pictures(self) -> bool:
        """Whether it is: else there is no use in telling it."""
        ...

    def expect(self, image: NDArray[np.uint8]) -> None:
        """(H, W, 3) uint8 BGR of a primary keyframe; the answer to its window stays the same."""
        ...


@runtime_checkable
class ResolvingBackbone(Protocol):
    """A backbone that solves a window again from its landmarks, without the images."""

    def resolve(self, prediction: Prediction, hints: Hints) -> Prediction:
        """The same views under the kit belief of `hints`; raises BackboneError.

        `hints.kit` holds what the other windows taught, not this one.
        """
        ...
