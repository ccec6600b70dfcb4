"""Thin-plate deformation of a sub-map by its active anchors, checked for folding (paper VI-D)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import thin_plate
from calm_edge.geometry.thin_plate import ThinPlate
from calm_edge.types import Float, Int

# anchors that would move by more than this share of their distance to the central camera are wrong
# associations, not errors of depth to correct
MAX_RELATIVE_SHIFT = 0.25
# an anchor's shift is compared with the median of this many neighbours; the anchor is torn if the
# difference exceeds three robust sigmas and TORN_SHIFT of its distance to the central camera
NEIGHBOURS = 8
TORN_SHIFT = 0.002
# Jacobian determinant (local volume ratio) of the deformation below which it counts as folding
MIN_DETERMINANT = 0.1
STIFFNESS_FACTORS = 10.0 ** np.arange(7)


@dataclass(frozen=True, slots=True)
class Deformation:
    """A thin-plate spline in the sub-map frame that moves no point by more than `limit`.

    limit: world units.
    """

    plate: ThinPlate
    limit: float

    def apply(self, points: NDArray[np.floating]) -> Float:
        """Deform points (M, 3), sub-map frame, world units.

        Displacements are clipped to the largest one of a control point, because the affine part
        extrapolates without bound.
        """
        points = np.asarray(points, np.float64)
        shift = self.plate.apply(points) - points
        length = np.linalg.norm(shift, axis=-1, keepdims=True)
        return np.asarray(points + shift * np.minimum(1.0, self.limit / np.maximum(length, 1e-12)))


def unchanged() -> Deformation:
    """The identity deformation."""
    none = np.empty((0, 3))
    return Deformation(thin_plate.fit(none, none, 0.0), 0.0)


def cells(points: Float, most: int) -> Int:
    """Cell label (M,) of each point (M, 3) in a cubic lattice with at most `most` filled cells.

    The finest such lattice is found by bisection of its cell size. Labels count from 0.
    """
    if len(points) <= most:
        return np.arange(len(points))
    low = points.min(0)
    extent = float(np.ptp(points, axis=0).max())
    fine, coarse = extent / most, 2 * extent + 1e-9
    label = np.zeros(len(points), np.int64)
    for _ in range(16):
        size = np.sqrt(max(fine * coarse, 1e-18))
        x, y, z = np.floor((points - low) / size).astype(np.int64).T
        found, finer = np.unique((x << 42) | (y << 21) | z, return_inverse=True)
        if len(found) <= most:
            label, coarse = finer, size
        else:
            fine = size
    return label


def control_points(p_s: Float, target_s: Float, n: Int, most: int) -> tuple[Float, Float]:
    """Source and target control points (C, 3), (C, 3), C <= `most`, evenly over the volume.

    p_s, target_s: (M, 3) sub-map frame. n: (M,) number of sub-maps that hold each anchor. A control
    point is the mean of the most observed anchors of its lattice cell, which averages the depth
    noise of single anchors.
    """
    label = cells(p_s, most)
    best = np.zeros(label.max(initial=-1) + 1, np.int64)
    np.maximum.at(best, label, n)
    keep = n == best[label]
    label = label[keep]
    count = np.bincount(label)[:, None]

    def mean(x: Float) -> Float:
        return np.stack([np.bincount(label, x[keep, i]) for i in range(3)], -1) / count

    return mean(p_s), mean(target_s)


def torn(p_s: Float, shift: Float, n: Int, centre_s: Float) -> NDArray[np.bool_]:
    """Mask (M,) of outliers: anchors with a shift that differs from that of their neighbours.

    Anchors on occlusion edges can have a depth error just within the tolerance of verification, and
    would dent the map. p_s: (M, 3). shift: (M, 3) target minus source. n: (M,) number of sub-maps
    that hold each anchor; only anchors of several sub-maps are compared and marked. centre_s: (3,)
    central camera.
    """
    from scipy.spatial import cKDTree

    out = np.zeros(len(n), bool)
    shared = np.flatnonzero(n > 1)
    if len(shared) <= NEIGHBOURS:
        return out
    near = np.asarray(cKDTree(p_s[shared]).query(p_s[shared], NEIGHBOURS + 1)[1])
    odd = np.linalg.norm(shift[shared] - np.median(shift[shared][near[:, 1:]], axis=1), axis=-1)
    floor = TORN_SHIFT * np.linalg.norm(p_s[shared] - centre_s, axis=-1)
    out[shared] = odd > np.maximum(3 * 1.4826 * np.median(odd), floor)
    return out


def fit_deformation(
    p_s: Float,
    target_s: Float,
    n: Int,
    centre_s: Float,
    probes: NDArray[np.floating],
    stiffness: float,
    most: int,
) -> Deformation:
    """Fit the deformation that takes anchors p_s (M, 3) to target_s (M, 3) (paper VI-D).

    Sub-map frame, world units. n: (M,) number of sub-maps that hold each anchor. centre_s: (3,)
    central camera. probes: (P, 3) points of the cloud at which, besides the control points, folding
    is checked. stiffness: weight of the bending energy (lambda of VI-D), inf for the best rigid
    motion. most: maximum number of control points. While the deformation's Jacobian determinant is
    below 0.1 anywhere, the stiffness is raised tenfold, up to 10^6 times (practically affine); if
    that folds too, the best rigid motion is used.
    """
    shift = np.linalg.norm(target_s - p_s, axis=-1)
    likely = shift <= MAX_RELATIVE_SHIFT * np.linalg.norm(p_s - centre_s, axis=-1)
    likely &= ~torn(p_s, target_s - p_s, n, centre_s)
    source, target = control_points(p_s[likely], target_s[likely], n[likely], most)
    limit = float(np.linalg.norm(target - source, axis=-1).max(initial=0.0))
    for factor in STIFFNESS_FACTORS if np.isfinite(stiffness) else ():
        plate = thin_plate.fit(source, target, stiffness * factor)
        worst = min(
            plate.determinants(probes).min(initial=1.0), plate.worst_at_controls().min(initial=1.0)
        )
        if worst >= MIN_DETERMINANT:
            return Deformation(plate, limit)
    return Deformation(thin_plate.fit_rigid(source, target), limit)
