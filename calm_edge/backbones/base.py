"""Interfaces of the backbones, i.e. of the visual geometry models (paper III), and their error."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera
from calm_edge.types import CalmEdgeError, Float, Hints, Prediction


class BackboneError(CalmEdgeError):
    """The model cannot be loaded, or a batch cannot be reconstructed.

    T_s_c_apart: as in Prediction, of a window that is refused: wrong stamps may be the cause.
    """

    T_s_c_apart: Float | None = None


class Backbone(Protocol):
    """Maps N images to intrinsics, poses, depth and confidence. Stateless and deterministic."""

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Reconstruct a batch of images (H, W, 3) uint8 BGR: primary, assistant, loop keyframe.

        hints: camera and stamp of each image, prior on the kit. Depth may be None for backbones
        that solve the poses first; `densify` then adds it. Raises BackboneError.
        """
        ...

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """Add depth and confidence to a prediction of these images, if it has none."""
        ...


@runtime_checkable
class ExpectsPictures(Protocol):
    """A backbone that can start processing an image before its window is complete."""

    @property
    def expects_pictures(self) -> bool:
        """Whether `expect` has an effect in the present configuration."""
        ...

    def expect(self, image: NDArray[np.uint8]) -> None:
        """Start processing a primary keyframe, (H, W, 3) uint8 BGR. Only saves time."""
        ...


@runtime_checkable
class LocatesViews(Protocol):
    """A backbone that can place a picture of another drive among the views of a solved window."""

    def locate_view(
        self,
        images: Sequence[NDArray[np.uint8]],
        hints: Hints,
        prediction: Prediction,
        camera: Camera,
    ) -> Float | None:
        """Pose T_s_c (4, 4), raw units, of the last of N + 1 images, taken by `camera`.

        hints: of all images; the last counts as the primary's. prediction: of the first N. None
        where it cannot be placed.
        """
        ...


@runtime_checkable
class ResolvingBackbone(Protocol):
    """A backbone that estimates the kit, so that what later windows show improves earlier ones."""

    def kit_sigma(self, hints: Hints) -> Float:
        """Sigmas (2,) under `hints.kit` of what guides the matching.

        Of the rig's rotation about its least known axis [rad], and of the log focal of the camera
        in which it is less known. See `layout.KIT_KNOWN`.
        """
        ...

    def resolve(self, prediction: Prediction, hints: Hints) -> Prediction:
        """Solve the views of a prediction again from its landmarks, without the images.

        With the kit belief in `hints` as prior.

        `hints.kit` must not contain the evidence of this window itself. Raises BackboneError.
        """
        ...
