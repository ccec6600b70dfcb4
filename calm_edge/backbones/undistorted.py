"""Undistorted pictures for a backbone that models pinhole cameras only (paper III)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import Backbone
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.through_lens import ThroughLens, lens_of
from calm_edge.geometry.undistortion import Undistortion, undistortions
from calm_edge.types import Float, Float32, Hints, Landmarks, Prediction

Pictures = Sequence[NDArray[np.uint8]]
# of each view; None where the picture is not undistorted
Maps = Sequence[Undistortion | None]


class UndistortedPictures:
    """Backbone that gives another one undistorted pictures where the lens is known.

    The lenses are those of the hints, which the other backbone gets too. Its prediction is brought
    back to the pictures as taken: cameras are `ThroughLens`, landmarks and depth have pixels of
    these pictures. So whoever uses a prediction has pictures and cameras that belong together.
    """

    def __init__(self, backbone: Backbone) -> None:
        self._backbone = backbone

    def infer(self, images: Pictures, hints: Hints) -> Prediction:
        """Reconstruct a window, see Backbone.infer."""
        maps = undistortions([hints.lenses[eye] for eye in hints.eyes.tolist()])
        if not any(maps):
            return self._backbone.infer(images, hints)
        return _as_taken(self._backbone.infer(_undistorted(images, maps), hints), maps)

    def densify(self, images: Pictures, hints: Hints, prediction: Prediction) -> Prediction:
        """Add depth, see Backbone.densify; the lenses are those of the prediction's cameras."""
        if prediction.depth is not None:
            return prediction
        lenses = [lens_of(camera) for camera in prediction.cameras]
        maps = undistortions(lenses)
        if not any(maps):
            return self._backbone.densify(images, hints, prediction)
        of_eye = dict(zip(hints.eyes.tolist(), lenses, strict=True))
        hints = replace(hints, lenses=(of_eye.get(0), of_eye.get(1)))
        straight = _straight(prediction, maps)
        dense = _as_taken(self._backbone.densify(_undistorted(images, maps), hints, straight), maps)
        return replace(prediction, depth=dense.depth, confidence=dense.confidence)


def _undistorted(images: Pictures, maps: Maps) -> Pictures:
    pairs = zip(images, maps, strict=True)
    return [image if each is None else each.picture(image) for image, each in pairs]


def _as_taken(prediction: Prediction, maps: Maps) -> Prediction:
    """Prediction of undistorted pictures, in the pixels of these as taken."""

    def taken(each: Undistortion, uv: Float) -> Float:
        return each.lens.project(each.camera.rays(uv))

    return replace(
        prediction,
        cameras=_cameras(prediction, maps, _through),
        landmarks=_landmarks(prediction, maps, taken),
        depth=_each_as_taken(prediction.depth, maps),
        confidence=_each_as_taken(prediction.confidence, maps),
    )


def _straight(prediction: Prediction, maps: Maps) -> Prediction:
    """The reverse of `_as_taken` for a prediction without depth."""

    def straight(each: Undistortion, uv: Float) -> Float:
        return each.camera.project(each.lens.rays(uv))

    return replace(
        prediction,
        cameras=_cameras(prediction, maps, _pinhole),
        landmarks=_landmarks(prediction, maps, straight),
    )


def _cameras(
    prediction: Prediction, maps: Maps, convert: Callable[[Camera, Undistortion], Camera]
) -> tuple[Camera, ...]:
    """Cameras of the views, converted where there are maps."""
    pairs = zip(prediction.cameras, maps, strict=True)
    return tuple(camera if each is None else convert(camera, each) for camera, each in pairs)


def _landmarks(
    prediction: Prediction, maps: Maps, convert: Callable[[Undistortion, Float], Float]
) -> Landmarks | None:
    """Landmarks with their pixels (N, 2) converted in the views that have maps."""
    marks = prediction.landmarks
    if marks is None:
        return None
    uv = marks.uv.astype(np.float64)
    for view, each in enumerate(maps):
        if each is not None:
            own = marks.view == view
            uv[own] = convert(each, uv[own])
    return replace(marks, uv=uv.astype(np.float32))


def _through(camera: Camera, maps: Undistortion) -> ThroughLens:
    """Camera of the undistorted picture as the pinhole of the lens would have it."""
    lens = maps.lens
    K = lens.matrix @ np.linalg.inv(maps.camera.matrix) @ camera.matrix
    optics = float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
    return ThroughLens(*optics, lens.width, lens.height, lens=lens)


def _pinhole(camera: Camera, maps: Undistortion) -> Perspective:
    K = maps.camera.matrix @ np.linalg.inv(maps.lens.matrix) @ camera.matrix
    return Perspective.from_matrix(K, camera.width, camera.height)


def _each_as_taken(values: Float32 | None, maps: Maps) -> Float32 | None:
    if values is None:
        return None
    pairs = zip(values, maps, strict=True)
    return np.stack([part if each is None else each.as_taken(part) for part, each in pairs])
