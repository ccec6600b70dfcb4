"""Point cloud error of a map against the ground truth (paper VII: accuracy, completeness)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.types import Float

CROP_M = 40.0
VOXEL_M = 0.15
TRUNCATE_M = 5.0
# The space above the road along the path, in the axes of the nearest camera: to either side, above
# it, and below it. A point there that is so far from every point of the truth is a ghost.
ROAD_M, ABOVE_M, BELOW_M, GHOST_M = 6.0, 2.0, 0.7, 0.5


@dataclass(frozen=True, slots=True)
class CloudError:
    """Mean distances [m] to the nearest point; small is good.

    accuracy: from map to truth. completeness: from truth to map. chamfer: mean of the two.
    """

    accuracy_m: float
    completeness_m: float
    chamfer_m: float


@dataclass(frozen=True, slots=True)
class Ghosts:
    """Points of a map where nothing is, above the road along the path; `count` of `points`."""

    count: int
    points: int

    @property
    def share(self) -> float:
        """Share of the map's points above the road that are ghosts; 0 if there are none."""
        return self.count / max(1, self.points)


def crop(points: Float, path: Float, radius: float = CROP_M) -> Float:
    """Points of (N, 3) within `radius` of a vertex of the path (P, 3)."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(path).query(points, distance_upper_bound=radius, workers=-1)
    return np.asarray(points[np.isfinite(distance)])


def voxel_means(points: Float, size: float = VOXEL_M) -> Float:
    """Voxel-grid downsampling, (N, 3) -> (M, 3): the mean of the points in each voxel."""
    if len(points) == 0:
        return points
    cell = np.floor((points - points.min(0)) / size).astype(np.int64)
    span = cell.max(0) + 1
    key = (cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2]
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(inverse, points[:, k], len(count)) for k in range(3)]
    return np.stack(sums, 1) / count[:, None]


def mean_distance(points: Float, to: Float, truncate: float = TRUNCATE_M) -> float:
    """Mean distance of points (N, 3) to the nearest of `to` (M, 3); each at most `truncate`."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(to).query(points, distance_upper_bound=truncate, workers=-1)
    return float(np.minimum(distance, truncate).mean())


def compare(points: Float, truth: Float, path: Float) -> CloudError | None:
    """Compare a map (N, 3) with the truth (M, 3), both in metres in the truth's world.

    Both are cropped to 40 m around path (P, 3) and downsampled to 0.15 m voxels; distances are
    truncated at 5 m. None if either has no point near the path.
    """
    finite = points[np.isfinite(points).all(1)]
    ours = voxel_means(crop(np.asarray(finite, np.float64), path))
    theirs = voxel_means(crop(np.asarray(truth, np.float64), path))
    if len(ours) == 0 or len(theirs) == 0:
        return None
    accuracy, completeness = mean_distance(ours, theirs), mean_distance(theirs, ours)
    return CloudError(accuracy, completeness, (accuracy + completeness) / 2)


def ghosts(points: Float, truth: Float, T_w_c: Float) -> Ghosts:
    """Count what a map (N, 3) shows above the road and the truth (M, 3) does not, metres.

    Cars that passed leave such points. T_w_c: (P, 4, 4) true poses of the camera. Both are
    downsampled to 0.15 m voxels.
    """
    from scipy.spatial import cKDTree

    path = T_w_c[:, :3, 3]
    finite = points[np.isfinite(points).all(1)]
    ours = voxel_means(crop(np.asarray(finite, np.float64), path, ROAD_M + ABOVE_M))
    theirs = voxel_means(crop(np.asarray(truth, np.float64), path))
    if len(ours) == 0 or len(theirs) == 0:
        return Ghosts(0, 0)
    _, nearest = cKDTree(path).query(ours, workers=-1)
    T = T_w_c[nearest]
    x, y, _ = np.einsum("nji,nj->in", T[:, :3, :3], ours - T[:, :3, 3])
    above = ours[(np.abs(x) < ROAD_M) & (y > -ABOVE_M) & (y < BELOW_M)]
    far, _ = cKDTree(theirs).query(above, distance_upper_bound=GHOST_M, workers=-1)
    return Ghosts(int(np.isinf(far).sum()), len(above))
