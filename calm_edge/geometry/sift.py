"""SIFT features and their matching between two images (Lowe, 2004; cv2.SIFT)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import epipolar
from calm_edge.geometry.camera import Camera

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int = NDArray[np.int64]

# Wider images are reduced to this width: features of the finest scale are rarely matched.
SIDE_PX = 960
# grey values with a smaller standard deviation are stretched
LEAST_CONTRAST = 30.0
# Lowe's ratio test: largest ratio of the best to the second best distance.
RATIO = 0.8
# Half of OpenCV's default, for scenes of low texture; `count` limits the others.
CONTRAST = 0.02
# Columns and rows of the grid of `well_spread`, and the occupied cells and columns it requires.
GRID = (8, 4)
MIN_CELLS, MIN_COLUMNS = 6, 3


@dataclass(frozen=True, slots=True)
class Features:
    """uv: (N, 2) px of the full image. vector: (N, 128) RootSIFT descriptors of unit length.

    Arandjelovic and Zisserman, "Three things everyone should know to improve object retrieval",
    2012.
    """

    uv: Float32
    vector: Float32


def detect(gray: NDArray[np.uint8], count: int) -> Features:
    """Detect the `count` strongest features of a grey image (H, W)."""
    height, width = gray.shape
    scale = min(1.0, SIDE_PX / max(width, height))
    if scale < 1:
        size = max(2, round(width * scale)), max(2, round(height * scale))
        small = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
    else:
        small = gray
    contrast = float(small.std())
    if 0 < contrast < LEAST_CONTRAST:
        # SIFT's threshold is absolute: a dark picture would have no features
        stretched = 128 + 2 * LEAST_CONTRAST / contrast * (small - small.mean())
        small = np.clip(stretched, 0, 255).astype(np.uint8)
    # without enable_precise_upscale all positions are off by a quarter of a pixel
    sift = cv2.SIFT.create(count, contrastThreshold=CONTRAST, enable_precise_upscale=True)
    points, vector = sift.detectAndCompute(small, None)
    if vector is None or len(points) == 0:
        return Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32))
    # SIFT repeats a keypoint for each of its dominant orientations: keep the first
    at, first = np.unique(cv2.KeyPoint.convert(points), axis=0, return_index=True)
    shares = vector[first] / np.maximum(vector[first].sum(1, keepdims=True), 1e-9)
    stretch = np.array([width / small.shape[1], height / small.shape[0]])
    uv = (at + 0.5) * stretch - 0.5
    return Features(uv.astype(np.float32), np.sqrt(shares).astype(np.float32))


def match(a: Features, b: Features) -> Int:
    """Match features: rows (M, 2) of a and b, mutual nearest neighbours passing the ratio test."""
    if min(len(a.uv), len(b.uv)) < 2:
        return np.zeros((0, 2), np.int64)
    likeness = a.vector @ b.vector.T
    to_b, to_a = likeness.argmax(1), likeness.argmax(0)
    rows = np.arange(len(a.uv))
    # squared distance of unit vectors: 2 - 2 likeness
    best, second = np.partition(likeness, -2, axis=1)[:, [-1, -2]].T
    clear = (1 - best) < RATIO**2 * (1 - second)
    keep = clear & (to_a[to_b] == rows)
    return np.stack([rows[keep], to_b[keep]], 1)


def consistent(
    a: Features, b: Features, threshold_px: float, cameras: tuple[Camera, Camera] | None = None
) -> Int:
    """Matches (M, 2), rows of a and b, that are inliers of one fundamental matrix.

    cameras: of a and b, whose distortion is undone.
    """
    pairs = match(a, b)
    uv_a, uv_b = a.uv[pairs[:, 0]].astype(np.float64), b.uv[pairs[:, 1]].astype(np.float64)
    if cameras is not None:
        uv_a, uv_b = cameras[0].undistorted(uv_a), cameras[1].undistorted(uv_b)
        seen = np.isfinite(uv_a[:, 0]) & np.isfinite(uv_b[:, 0])
        pairs, uv_a, uv_b = pairs[seen], uv_a[seen], uv_b[seen]
    found = epipolar.fundamental(uv_a, uv_b, threshold_px)
    return pairs[found.inliers] if found is not None else pairs[:0]


def cells(uv: Float | Float32, size: Int) -> Int:
    """Index (M,) of the GRID cell of each pixel (M, 2), column-major. size: (2,) width, height."""
    at = np.clip((uv + 0.5) / size * GRID, 0, np.array(GRID) - 1).astype(np.int64)
    return np.asarray(at[:, 0] * GRID[1] + at[:, 1])


def well_spread(uv: Float | Float32, size: Int) -> bool:
    """Whether pixels (M, 2) cover at least MIN_CELLS cells in MIN_COLUMNS columns of the GRID."""
    taken = np.unique(cells(uv, size))
    return len(taken) >= MIN_CELLS and len(np.unique(taken // GRID[1])) >= MIN_COLUMNS
