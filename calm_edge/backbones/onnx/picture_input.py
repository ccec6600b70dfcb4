"""Convert camera images to a network's input tensor, and pixels of the input back to the images.

Each image is resized and centred on a canvas, of the same size for the whole batch: it is cropped
where it exceeds the canvas and padded where it is smaller. Pixel coordinates follow the convention
of cv2.resize.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.onnx.manifest import InputSpec
from calm_edge.geometry.camera import Camera
from calm_edge.types import Bytes, Float, Float32

_INTERPOLATION = {
    "area": cv2.INTER_AREA,
    "bilinear": cv2.INTER_LINEAR,
    "bicubic": cv2.INTER_CUBIC,
}


@dataclass(frozen=True, slots=True)
class Fit:
    """Placement of an image in the network input, all (width, height) px.

    picture, resized, input: sizes of the image, of the resized image and of the input.
    offset: position of the resized image's first pixel in the input, negative if cropped.
    """

    picture: tuple[int, int]
    resized: tuple[int, int]
    offset: tuple[int, int]
    input: tuple[int, int]

    @property
    def scale(self) -> tuple[float, float]:
        """Input pixels per image pixel, in x and y."""
        return self.resized[0] / self.picture[0], self.resized[1] / self.picture[1]

    @property
    def is_whole(self) -> bool:
        """Whether the image fills the input, neither cropped nor padded."""
        return self.resized == self.input

    def camera(self, of_input: Camera) -> Camera:
        """Convert the camera of the input to that of the image."""
        (x, y), (width, height), (sx, sy) = self.offset, self.resized, self.scale
        cx, cy = of_input.cx - x, of_input.cy - y
        resized = replace(of_input, cx=cx, cy=cy, width=width, height=height)
        return resized.scaled(1 / sx, 1 / sy)

    def positions(self, axis: int, count: int, map_size: int) -> Float:
        """Pixel centres (count,) of the image resized to `count` px, in pixels of an input map.

        axis: 0 x, 1 y. map_size: size of the map (a network output) along that axis.
        """
        in_resized = (np.arange(count) + 0.5) * (self.resized[axis] / count)
        in_input = in_resized + self.offset[axis]
        return np.asarray(in_input * (map_size / self.input[axis]) - 0.5)


def fit_pictures(spec: InputSpec, sizes: Sequence[tuple[int, int]]) -> list[Fit]:
    """Placement of each image of (width, height) px, with a common input size."""
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
    """Input tensor, float32 in `spec.layout`, of (H, W, 3) uint8 BGR images."""
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
    """Size of the resized image, and of the canvas that this image alone needs."""
    reference = {"width": width, "longest": max(width, height), "keep": 0}[spec.resize]
    scale = spec.size_px / reference if reference else 1.0
    # round to a multiple: nearest, down or up; 1e-6 absorbs rounding errors of exact multiples
    up = {"stretch": 0.5, "crop": 1e-6, "pad": 1 - 1e-6}[spec.multiple_by]
    resized, canvas = [], []
    for length, fixed in ((width * scale, 0), (height * scale, spec.height_px)):
        own = max(1, round(length))
        target = fixed or max(1, floor(length / spec.multiple + up)) * spec.multiple
        canvas.append(target)
        resized.append(target if spec.multiple_by == "stretch" else own)
    return (resized[0], resized[1]), (canvas[0], canvas[1])


def _laid_in(spec: InputSpec, image: Bytes, fit: Fit) -> Float32:
    """An image placed in the input canvas (H, W, C), values in [0, 1]."""
    if fit.resized != fit.picture:
        shrinks = fit.resized[0] < fit.picture[0] or fit.resized[1] < fit.picture[1]
        # INTER_AREA is nearest-neighbour when enlarging
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
    """Slices, along an axis, of the canvas and of the resized image where the two overlap."""
    start, length, room = fit.offset[axis], fit.resized[axis], fit.input[axis]
    first, last = max(0, start), min(room, start + length)
    return slice(first, last), slice(first - start, last - start)
