"""Undistorted pictures for a backbone that knows pinhole cameras alone (paper III)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import Backbone
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.through_lens import ThroughLens
from calm_edge.geometry.undistortion import Undistortion, undistortion
from calm_edge.types import Float32, Hints, Landmarks, Prediction

Pictures = Sequence[NDArray[np.uint8]]


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
        lenses = [hints.lenses[eye] for eye in hints.eyes.tolist()]
        maps = [_maps(lens) for lens in lenses]
        if not any(maps):
            return self._backbone.infer(images, hints)
        return _as_taken(self._backbone.infer(_undistorted(images, maps), hints), maps)

    def densify(self, images: Pictures, hints: Hints, prediction: Prediction) -> Prediction:
        """Add depth, see Backbone.densify; the lenses are those of the prediction's cameras."""
        if prediction.depth is not None:
            return prediction
        lenses = [c.lens if isinstance(c, ThroughLens) else None for c in prediction.cameras]
        maps = [_maps(lens) for lens in lenses]
        if not any(maps):
            return self._backbone.densify(images, hints, prediction)
        of_eye = dict(zip(hints.eyes.tolist(), lenses, strict=True))
        hints = replace(hints, lenses=(of_eye.get(0), of_eye.get(1)))
        straight = _straight(prediction, maps)
        dense = _as_taken(self._backbone.densify(_undistorted(images, maps), hints, straight), maps)
        return replace(prediction, depth=dense.depth, confidence=dense.confidence)


@lru_cache(maxsize=8)
def _maps(lens: Camera | None) -> Undistortion | None:
    return None if lens is None or lens.is_pinhole else undistortion(lens)


def _undistorted(images: Pictures, maps: Sequence[Undistortion | None]) -> Pictures:
    pairs = zip(images, maps, strict=True)
    return [image if each is None else each.picture(image) for image, each in pairs]


def _as_taken(prediction: Prediction, maps: Sequence[Undistortion | None]) -> Prediction:
    """Prediction of undistorted pictures, in the pixels of these as taken."""
    cameras = tuple(
        camera if each is None else _through(camera, each)
        for camera, each in zip(prediction.cameras, maps, strict=True)
    )
    marks = prediction.landmarks
    if marks is not None:
        uv = marks.uv.astype(np.float64)
        for view, each in enumerate(maps):
            if each is not None:
                own = marks.view == view
                rays = each.camera.rays(uv[own])
                uv[own] = each.lens.project(rays)
        marks = replace(marks, uv=uv.astype(np.float32))
    return replace(
        prediction,
        cameras=cameras,
        landmarks=marks,
        depth=_each_as_taken(prediction.depth, maps),
        confidence=_each_as_taken(prediction.confidence, maps),
    )


def _straight(prediction: Prediction, maps: Sequence[Undistortion | None]) -> Prediction:
    """The reverse of `_as_taken` for a prediction without depth."""
    cameras = tuple(
        camera if each is None else _pinhole(camera, each)
        for camera, each in zip(prediction.cameras, maps, strict=True)
    )
    marks = prediction.landmarks
    if marks is not None:
        marks = _straight_landmarks(marks, maps)
    return replace(prediction, cameras=cameras, landmarks=marks)


def _straight_landmarks(marks: Landmarks, maps: Sequence[Undistortion | None]) -> Landmarks:
    uv = marks.uv.astype(np.float64)
    for view, each in enumerate(maps):
        if each is not None:
            own = marks.view == view
            uv[own] = each.camera.project(each.lens.rays(uv[own]))
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


def _each_as_taken(values: Float32 | None, maps: Sequence[Undistortion | None]) -> Float32 | None:
    if values is None:
        return None
    pairs = zip(values, maps, strict=True)
    return np.stack([part if each is None else each.as_taken(part) for part, each in pairs])
