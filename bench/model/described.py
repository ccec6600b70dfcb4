"""SIFT descriptors at SIFT keypoints, and at other given points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calm_edge.backbones.bundle.tracks import detect_corners
from calm_edge.geometry.sift import CONTRAST
from calm_edge.types import Bytes, Float, Float32, Int

# Second scale-space layer of octaves 0, 1 and 2, and the diameters of SIFT keypoints there.
OCTAVES = (0, 1, 2)
LAYER = 1
BASE_SIGMA, LAYERS = 1.6, 3
ORIENTATION_BINS = 36
ORIENTATION_SAMPLES = 17
SUBPIXEL = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01)
NO_CORNERS = np.zeros((0, 2), np.float32)


@dataclass(frozen=True, slots=True)
class Described:
    """Descriptors of points; a point may have several.

    uv: (N, 2) px. vector: (N, 128) unit vectors. index: (N,) row of the described point in the
    caller's array.
    """

    uv: Float32
    vector: Float32
    index: Int


def gray_of(image: Bytes) -> Bytes:
    """Convert a picture (H, W, 3) BGR to grey (H, W)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


def keypoints(gray: Bytes, count: int) -> Sequence[cv2.KeyPoint]:
    """Detect SIFT keypoints, strongest first; one with two orientations appears twice."""
    return tuple(_sift(count).detect(gray, None))


def corners(gray: Bytes, count: int) -> Float32:
    """Shi-Tomasi corners (N, 2) px with the settings of bundle's tracks, refined to subpixels."""
    uv = detect_corners(gray, NO_CORNERS, count)
    if len(uv) == 0:
        return uv
    refined = cv2.cornerSubPix(gray, uv.reshape(-1, 1, 2).copy(), (3, 3), (-1, -1), SUBPIXEL)
    return np.asarray(refined.reshape(-1, 2), np.float32)


def at_points(gray: Bytes, uv: Float | Float32) -> list[cv2.KeyPoint]:
    """Make keypoints at uv (N, 2) px, one per octave in OCTAVES, oriented by the image gradient.

    class_id of a keypoint is its row in uv.
    """
    made = []
    for octave in OCTAVES:
        sigma = BASE_SIGMA * 2 ** (LAYER / LAYERS + octave)
        angles = _orientations(gray, np.asarray(uv, np.float32), sigma)
        for k, ((x, y), angle) in enumerate(zip(uv, angles, strict=True)):
            # OpenCV packs the octave in the low byte and the layer in the second byte
            packed = octave | (LAYER << 8)
            made.append(cv2.KeyPoint(float(x), float(y), 2 * sigma, float(angle), 0, packed, k))
    return made


def describe(gray: Bytes, points: Sequence[cv2.KeyPoint]) -> Described:
    """Compute RootSIFT descriptors of keypoints; `index` is taken from their class_id.

    Arandjelovic, Zisserman, "Three things everyone should know to improve object retrieval", 2012.
    """
    if not points:
        return Described(NO_CORNERS, np.zeros((0, 128), np.float32), np.zeros(0, np.int64))
    kept, vector = _sift(0).compute(gray, points)
    shares = vector / np.maximum(vector.sum(1, keepdims=True), 1e-9)
    uv = np.asarray(cv2.KeyPoint.convert(kept), np.float32)
    index = np.array([p.class_id for p in kept], np.int64)
    return Described(uv, np.sqrt(shares).astype(np.float32), index)


def _sift(count: int) -> cv2.SIFT:
    return cv2.SIFT.create(count, contrastThreshold=CONTRAST, enable_precise_upscale=True)


def _orientations(gray: Bytes, uv: Float32, sigma: float) -> Float:
    """Dominant gradient direction (N,) at uv, degrees in OpenCV's convention for keypoints."""
    if len(uv) == 0:
        return np.zeros(0)
    smooth = cv2.GaussianBlur(gray.astype(np.float32), (0, 0), sigma)
    reach = np.linspace(-4.5 * sigma, 4.5 * sigma, ORIENTATION_SAMPLES, dtype=np.float32)
    x = uv[:, 0, None, None] + reach[None, None, :] + 0 * reach[None, :, None]
    y = uv[:, 1, None, None] + reach[None, :, None] + 0 * reach[None, None, :]
    flat = (-1, ORIENTATION_SAMPLES)
    gradient = [
        cv2.remap(
            cv2.Sobel(smooth, cv2.CV_32F, dx, dy), x.reshape(flat), y.reshape(flat),
            cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
        ).reshape(len(uv), -1)
        for dx, dy in ((1, 0), (0, 1))
    ]  # fmt: skip
    size, angle = np.hypot(*gradient), np.degrees(np.arctan2(gradient[1], gradient[0])) % 360
    near = np.exp(-(reach[:, None] ** 2 + reach[None] ** 2) / (2 * (1.5 * sigma) ** 2)).ravel()
    width = 360 / ORIENTATION_BINS
    bins = np.floor(angle / width).astype(np.int64) % ORIENTATION_BINS
    rows = np.arange(len(uv))[:, None] * ORIENTATION_BINS
    votes: Float = np.zeros(len(uv) * ORIENTATION_BINS)
    np.add.at(votes, (rows + bins).ravel(), (size * near).ravel())
    circle = votes.reshape(len(uv), ORIENTATION_BINS)
    circle = (np.roll(circle, 1, 1) + 2 * circle + np.roll(circle, -1, 1)) / 4
    return np.asarray((circle.argmax(1) + 0.5) * width)
