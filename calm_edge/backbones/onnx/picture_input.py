"""Camera pictures become a network's input, and pixels find their way back.

Every picture is resized, then laid into the middle of a canvas that all of a batch share: what
sticks out is cropped, what is left free is padded. Pixel centres move as cv2.resize moves them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.onnx.manifest import InputSpec
from calm_edge.geometry import pinhole
from calm_edge.types import Bytes, Float, Float32

_INTERPOLATION = {
    "area": cv2.INTER_AREA,
    "bilinear": cv2.INTER_LINEAR,
    "bicubic": cv2.INTER_CUBIC,
}


@dataclass(frozen=True, slots=True)
class Fit:
    """How one picture lies in the input: (width, height) px of both, of the picture as resized,
    and the place of the resized picture's first pixel, negative where it is cropped."""

    picture: tuple[int, int]
    resized: tuple[int, int]
    offset: tuple[int, int]
    input: tuple[int, int]

    @property
    def scale(self) -> tuple[float, float]:
        """Input pixels a picture pixel, in x and y."""
        return self.resized[0] / self.picture[0], self.resized[1] / self.picture[1]

    @property
    def is_whole(self) -> bool:
        """The picture is the input, neither cropped nor padded."""
        return self.resized == self.input

    def intrinsics(self, K_input: Float) -> Float:
        """K (3, 3) px of the input -> px of the picture."""
        K = K_input.astype(np.float64)
        K[:2, 2] -= self.offset
        sx, sy = self.scale
        return pinhole.resized(K, 1 / sx, 1 / sy)

    def positions(self, axis: int, count: int, map_size: int) -> Float:
        """Where in a map of the input the pixels of a picture shrunk to `count` lie, px of the map.

        axis: 0 x, 1 y. map_size: of the map along that axis. (count,)
        """
        in_resized = (np.arange(count) + 0.5) * (self.resized[axis] / count)
        in_input = in_resized + self.offset[axis]
        return np.asarray(in_input * (map_size / self.input[axis]) - 0.5)


def fit_pictures(spec: InputSpec, sizes: Sequence[tuple[int, int]]) -> list[Fit]:
    """One a picture of (width, height) px, all of one input size."""
    each = [_of_picture(spec, width, height) for width, height in sizes]
    common = max if spec.common_by == "pad" else min
    width = common(canvas[0] for _, canvas in each)
    height = common(canvas[1] for _, canvas in each)
    fits = []
    for size, (resized, _) in zip(sizes, each, strict=True):
        offset = ((width - resized[0]) // 2, (height - resized[1]) // 2)
        fits.append(Fit((size[0], size[1]), resized, offset, (width, height)))
    return fits


def input_tensor(spec: InputSpec, images: Sequence[Bytes], fits: Sequence[Fit]) -> Float32:
    """(H, W, 3) uint8 BGR pictures as the float32 tensor of `spec.layout`."""
    views = np.stack([_laid_in(spec, i, f) for i, f in zip(images, fits, strict=True)])
    values = (views - np.asarray(spec.mean, np.float32)) / np.asarray(spec.std, np.float32)
    if spec.layout.endswith("CHW"):
        values = values.transpose(0, 3, 1, 2)
    if spec.layout.startswith("B"):
        values = values[None]
    return np.ascontiguousarray(values, np.float32)


def _of_picture(
    spec: InputSpec, width: int, height: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Size of the resized picture, and of the canvas it alone would need."""
    reference = {"width": width, "longest": max(width, height), "keep": 0}[spec.resize]
    scale = spec.size_px / reference if reference else 1.0
    # to the nearest, below or above; rounding noise must not push a fitting length on
    up = {"stretch": 0.5, "crop": 1e-6, "pad": 1 - 1e-6}[spec.multiple_by]
    resized, canvas = [], []
    for length, fixed in ((width * scale, 0), (height * scale, spec.height_px)):
        own = max(1, round(length))
        target = fixed or max(1, floor(length / spec.multiple + up)) * spec.multiple
        canvas.append(target)
        resized.append(target if spec.multiple_by == "stretch" else own)
    return (resized[0], resized[1]), (canvas[0], canvas[1])


def _laid_in(spec: InputSpec, image: Bytes, fit: Fit) -> Float32:
    """(H, W, C) of the input, values in [0, 1]."""
    if fit.resized != fit.picture:
        shrinks = fit.resized[0] < fit.picture[0] or fit.resized[1] < fit.picture[1]
        # averaging over an area is no interpolation where a picture grows
        by = "bilinear" if spec.interpolation == "area" and not shrinks else spec.interpolation
        image = np.asarray(cv2.resize(image, fit.resized, interpolation=_INTERPOLATION[by]))
    colours: NDArray[np.uint8] = image
    if spec.channels == "gray":
        colours = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)[..., None]
    elif spec.channels == "rgb":
        colours = image[..., ::-1]
    values = colours.astype(np.float32) / np.float32(255)
    if fit.is_whole:
        return values
    canvas = np.full((*fit.input[::-1], values.shape[2]), spec.pad_value, np.float32)
    into, part = zip(*(_overlap(fit, axis) for axis in (1, 0)), strict=True)
    canvas[into] = values[part]
    return canvas


def _overlap(fit: Fit, axis: int) -> tuple[slice, slice]:
    """Along an axis: where the picture lies on the canvas, and the part of it that does."""
    start, length, room = fit.offset[axis], fit.resized[axis], fit.input[axis]
    first, last = max(0, start), min(room, start + length)
    return slice(first, last), slice(first - start, last - start)
