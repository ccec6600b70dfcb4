"""Calibrated stereo as a peer: metric motion between frames of a rectified pair of cameras.

Points are triangulated between the two pictures of one instant with the published calibration and
spacing, and the motion to a later primary picture follows from their pixels there. No pose is
handed on, so that the errors of different motions are independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from bench.drives import pictures, read_picture
from calm_edge.evaluation.truth import read_truth
from calm_edge.types import Float, Float32, Int

# Frames from one end of a motion to the other.
APART = 4
MOST_FEATURES, RATIO = 3000, 0.8
# Rows of a match in a rectified pair differ by no more; a smaller disparity leaves depth too noisy.
ROW_PX, LEAST_DISPARITY_PX = 1.5, 8.0
INLIER_PX, LEAST_INLIERS = 1.5, 30


@dataclass(frozen=True, slots=True)
class Motions:
    """Distances travelled, metres: (M,) between frames first (M,) and first + APART."""

    first: Int
    metres: Float


@dataclass(frozen=True, slots=True)
class _Features:
    uv: Float
    descriptors: Float32


def motions(folder: Path, spacing_m: float, apart: int = APART) -> Motions:
    """Motions along a rectified sequence folder; those with few inliers are left out.

    Needs calib.txt, of equal optics for both eyes.
    """
    cameras = read_truth(folder).cameras
    assert cameras is not None
    K = cameras[0].matrix
    left, right = pictures(folder, 0), pictures(folder, 1)
    first, metres = [], []
    before: tuple[Float, Float32] | None = None
    for k in range(0, min(len(left), len(right)), apart):
        seen = _features(left[k])
        if before is not None:
            t = _motion(before[0], before[1], seen, K)
            if t is not None:
                first.append(k - apart)
                metres.append(float(np.linalg.norm(t)))
        before = _triangulated(seen, _features(right[k]), K, spacing_m)
    return Motions(np.array(first, np.int64), np.array(metres))


def _features(file: Path) -> _Features:
    gray = cv2.cvtColor(read_picture(file), cv2.COLOR_BGR2GRAY)
    points, descriptors = cv2.SIFT.create(MOST_FEATURES).detectAndCompute(gray, None)
    uv = np.array([p.pt for p in points], np.float64).reshape(-1, 2)
    return _Features(uv, np.asarray(descriptors, np.float32).reshape(len(uv), -1))


def _matches(a: Float32, b: Float32) -> Int:
    """Rows (M, 2) of descriptors that are nearest to each other, clearly before the second."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), np.int64)
    two = cv2.BFMatcher(cv2.NORM_L2).knnMatch(a, b, k=2)
    kept = [(m.queryIdx, m.trainIdx) for m, n in two if m.distance < RATIO * n.distance]
    return np.array(kept, np.int64).reshape(-1, 2)


def _triangulated(
    left: _Features, right: _Features, K: Float, spacing_m: float
) -> tuple[Float, Float32]:
    """Points (P, 3) in the primary's axes, metres, and their descriptors."""
    pairs = _matches(left.descriptors, right.descriptors)
    uv, other = left.uv[pairs[:, 0]], right.uv[pairs[:, 1]]
    disparity = uv[:, 0] - other[:, 0]
    good = (np.abs(uv[:, 1] - other[:, 1]) < ROW_PX) & (disparity > LEAST_DISPARITY_PX)
    points = triangulated(uv[good], disparity[good], K, spacing_m)
    return points, left.descriptors[pairs[good, 0]]


def triangulated(uv: Float, disparity: Float, K: Float, spacing_m: float) -> Float:
    """Points (P, 3) at pixels uv (P, 2) with disparities (P,) px of a rectified pair."""
    depth = K[0, 0] * spacing_m / disparity
    rays = np.concatenate([uv, np.ones((len(uv), 1))], 1) @ np.linalg.inv(K).T
    return np.asarray(rays * depth[:, None])


def _motion(points: Float, descriptors: Float32, seen: _Features, K: Float) -> Float | None:
    pairs = _matches(descriptors, seen.descriptors)
    return motion(points[pairs[:, 0]], seen.uv[pairs[:, 1]], K)


def motion(points: Float, uv: Float, K: Float) -> Float | None:
    """Translation (3,) of the camera that sees points (P, 3) at uv (P, 2); None with few inliers.

    In the axes of the points, from their origin.
    """
    if len(points) < LEAST_INLIERS:
        return None
    found, r, t, inliers = cv2.solvePnPRansac(
        points, uv, K, None, reprojectionError=INLIER_PX, iterationsCount=500, confidence=0.9999
    )
    if not found or inliers is None or len(inliers) < LEAST_INLIERS:
        return None
    kept = inliers[:, 0]
    r, t = cv2.solvePnPRefineLM(points[kept], uv[kept], K, None, r, t)
    rotation, _ = cv2.Rodrigues(r)
    return np.asarray(-rotation.T @ t[:, 0])


def log_scale(lengths: Float, metres: Float) -> tuple[float, float]:
    """Median log ratio of lengths (M,) to metres (M,), and its standard error.

    The error of a median of normally distributed values, their sigma from the median deviation.
    """
    ratio = np.log(lengths / metres)
    middle = float(np.median(ratio))
    sigma = 1.4826 * float(np.median(np.abs(ratio - middle)))
    return middle, 1.2533 * sigma / len(ratio) ** 0.5
