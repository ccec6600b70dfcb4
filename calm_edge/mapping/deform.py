"""From active anchors to a deformed cloud, guarded against folds (paper VI-D)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import thin_plate
from calm_edge.geometry.thin_plate import ThinPlate
from calm_edge.types import Float, Int

# a control point that would move farther than this share of its distance to the central camera
# is a wrong association, not a depth distortion
MAX_RELATIVE_SHIFT = 0.25
# shifts are compared with those of this many shared anchors around; a difference counts as torn
# above three robust sigmas of all of them, and only above this share of the distance
NEIGHBOURS = 8
TORN_SHIFT = 0.002
# below this volume ratio the map counts as folding
MIN_DETERMINANT = 0.1
STIFFER = 10.0 ** np.arange(7)


@dataclass(frozen=True, slots=True)
class Deformation:
    """A thin plate in the sub-map frame that moves no point by more than `limit`, world units.

    stiffness: the one that was used, without unit; larger than asked where the map folded.
    """

    plate: ThinPlate
    limit: float
    stiffness: float

    def apply(self, points: NDArray[np.floating]) -> Float:
        """(M, 3) -> (M, 3), sub-map frame, world units.

        Away from the controls the affine part extrapolates without bound, so a displacement is
        shortened to the largest one any control point makes.
        """
        points = np.asarray(points, np.float64)
        shift = self.plate.apply(points) - points
        length = np.linalg.norm(shift, axis=-1, keepdims=True)
        return np.asarray(points + shift * np.minimum(1.0, self.limit / np.maximum(length, 1e-12)))


def unchanged() -> Deformation:
    """Every point stays where its sub-map puts it."""
    none = np.empty((0, 3))
    return Deformation(thin_plate.fit(none, none, 0.0), 0.0, float("inf"))


def cells(points: Float, most: int) -> Int:
    """(M,) labels from 0 of the finest cubic lattice, by bisection, with at most `most` cells."""
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
    """At most `most` pairs (C, 3), (C, 3) of source and target, evenly over the anchors' volume.

    p_s, target_s: (M, 3) sub-map frame. n: (M,) observation counts. A control point is the mean
    of the most observed anchors of its lattice cell: a single anchor would hand its own depth
    noise to everything around it.
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
    """(M,) shared anchors whose shift (M, 3) disagrees with the shared anchors around them.

    An anchor on an occlusion edge gets a depth that passes the verification's tolerance and still
    is off by most of it; interpolated by a plate this soft it would dent the map. p_s: (M, 3),
    centre_s: (3,), n: (M,) observation counts; anchors of a single sub-map are never torn.
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
    """The deformation taking anchors p_s (M, 3) to target_s (M, 3), sub-map frame, world units.

    n: (M,) observation counts. centre_s: (3,) central camera. probes: (P, 3) points of the cloud at
    which folding is looked for, besides the controls. stiffness: inf asks for the best rigid
    motion. most: control points at most. Where det dPhi/dx falls below 0.1 the stiffness is raised
    tenfold up to a million times (which is an affine fit), and if that folds too the best rigid
    motion is used.
    """
    shift = np.linalg.norm(target_s - p_s, axis=-1)
    likely = shift <= MAX_RELATIVE_SHIFT * np.linalg.norm(p_s - centre_s, axis=-1)
    likely &= ~torn(p_s, target_s - p_s, n, centre_s)
    source, target = control_points(p_s[likely], target_s[likely], n[likely], most)
    limit = float(np.linalg.norm(target - source, axis=-1).max(initial=0.0))
    for factor in STIFFER if np.isfinite(stiffness) else ():
        plate = thin_plate.fit(source, target, stiffness * factor)
        worst = min(
            plate.determinants(probes).min(initial=1.0), plate.worst_at_controls().min(initial=1.0)
        )
        if worst >= MIN_DETERMINANT:
            return Deformation(plate, limit, float(stiffness * factor))
    return Deformation(thin_plate.fit_rigid(source, target), limit, float("inf"))
