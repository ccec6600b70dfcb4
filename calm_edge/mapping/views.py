"""Dense views of a sub-map: back-projection, depth sampling, and verification (paper VI-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, back_project_each
from calm_edge.types import AnchorTable, Bytes, CalmEdgeError, Float, Float32, Int, Int32, Submap

Bool = NDArray[np.bool_]


class MappingError(CalmEdgeError):
    """A sub-map cannot be mapped."""


@dataclass(frozen=True, slots=True)
class DenseViews:
    """Depth maps of a sub-map's N views in batch order, prepared for sampling.

    inverse_depth: (N, h, w) 1/z in 1/world units, 0 unknown. usable: (N, h, w) confident and
    within range. cameras: N, of the full image. T_s_c: (N, 4, 4) world units.
    map_per_image: (N, 2) depth-map pixels per image pixel, (x, y).
    """

    inverse_depth: Float32
    usable: Bool
    cameras: tuple[Camera, ...]
    T_s_c: Float
    map_per_image: Float

    def to_map(self, view: Int | Int32, uv: NDArray[np.floating]) -> Float:
        """Depth-map pixels (..., 2) of image pixels (..., 2) of views (...), as in cv2.resize."""
        return np.asarray((uv + 0.5) * self.map_per_image[view] - 0.5)

    def to_image(self, view: Int, xy: NDArray[np.floating]) -> Float:
        """Image pixels (..., 2) of depth-map pixels (..., 2) of views (...)."""
        return np.asarray((xy + 0.5) / self.map_per_image[view] - 0.5)


@dataclass(frozen=True, slots=True)
class Sightings:
    """Projections of M points into N views, compared with the views' depth.

    uv: (M, N, 2) image px. agrees: (M, N) the view's depth equals the point's within tolerance.
    floats: (M, N) the view's depth is larger, i.e. the point floats in the view's free space.
    """

    uv: Float32
    agrees: Bool
    floats: Bool

    def of(self, points: Int | Bool) -> Sightings:
        """The subset of points given by indices or mask."""
        return Sightings(self.uv[points], self.agrees[points], self.floats[points])

    def rows(self, anchor: Int, p_s: Float) -> AnchorTable:
        """The points as anchors (M,) at p_s (M, 3), observed in each view that agrees."""
        row, view = np.nonzero(self.agrees)
        seen = anchor[row].astype(np.int32)
        return AnchorTable(anchor, p_s, seen, view.astype(np.int32), self.uv[row, view])


def prepare(
    submap: Submap,
    depth: Float32,
    confidence: NDArray[np.float32] | Bytes,
    image_size: Int,
    min_confidence: float,
    max_range: float,
) -> DenseViews:
    """Build the dense views of a sub-map from its depth (N, h, w), raw unit.

    confidence: (N, h, w) in [0, 1], or uint8 in 1/255. image_size: (N, 2) width, height of the
    full images, px. max_range: largest z-depth, world units. Raises MappingError if the arrays
    do not match the sub-map.
    """
    n = len(submap.T_s_c)
    if depth.ndim != 3 or len(depth) != n or depth.shape != confidence.shape:
        raise MappingError(
            f"sub-map {submap.id}: {n} views but depth {depth.shape}, confidence "
            f"{confidence.shape}; run calm-edge map again"
        )
    if min(depth.shape[1:]) < 2 or image_size.shape != (n, 2):
        raise MappingError(
            f"sub-map {submap.id}: depth {depth.shape[1:]} px is below 2 x 2, or {len(image_size)} "
            f"image sizes do not match {n} views; run calm-edge map again"
        )
    known = np.isfinite(depth) & (depth > 0)
    z = np.where(known, depth, 1.0) * np.float32(submap.scale)
    floor = min_confidence * (255 if confidence.dtype == np.uint8 else 1)
    height, width = depth.shape[1:]
    return DenseViews(
        np.where(known, 1 / z, 0).astype(np.float32),
        known & (confidence > floor) & (z <= max_range),
        submap.cameras,
        submap.T_s_c,
        np.array([width, height]) / image_size,
    )


def lift(views: DenseViews, view: Int, uv: NDArray[np.floating], z: NDArray[np.floating]) -> Float:
    """Back-project image pixels uv (M, 2) of views (M,) at z-depths (M,): (M, 3), sub-map frame."""
    p_c = back_project_each(views.cameras, view, np.asarray(uv, np.float64), np.asarray(z))
    T = views.T_s_c[view]
    return np.asarray((T[:, :3, :3] @ p_c[..., None])[..., 0] + T[:, :3, 3])


def lift_all(views: DenseViews) -> tuple[Int, Float, Float32]:
    """Back-project all usable pixels: flat index (M,), point (M, 3) in the sub-map frame, z (M,).

    Flat indices are into (N, h, w).
    """
    n, height, width = views.inverse_depth.shape
    row, column = np.divmod(np.arange(height * width), width)
    pixels = np.stack([column, row], -1)
    # the pictures of a camera have the same directions
    seen: dict[tuple[Camera, tuple[float, ...]], Float] = {}
    found = [np.flatnonzero(usable) for usable in views.usable.reshape(n, -1)]
    points, depths = [np.empty((0, 3))], [np.empty(0, np.float32)]
    for view, pixel in enumerate(found):
        depth = 1 / views.inverse_depth[view].reshape(-1)[pixel]
        key = views.cameras[view], tuple(views.map_per_image[view])
        if key not in seen:
            seen[key] = key[0].normalized(views.to_image(np.array(view), pixels))
        T = views.T_s_c[view]
        p_c = np.column_stack([seen[key][pixel] * depth[:, None], depth])
        points.append(p_c @ T[:3, :3].T + T[:3, 3])
        depths.append(depth)
    pixel = np.concatenate([k * height * width + found_k for k, found_k in enumerate(found)])
    return pixel, np.concatenate(points), np.concatenate(depths)


def sample(views: DenseViews, view: Int, uv: NDArray[np.floating]) -> Float:
    """Sample z-depth (...) of views (...) at image pixels uv (..., 2); 0 where not usable.

    World units. Bilinear in inverse depth, which is exact on planes; the nearest pixel's depth
    would be off by several percent on a road in small depth maps. Nearest pixel if one of the
    four neighbours is unknown.
    """
    _, height, width = views.inverse_depth.shape
    xy = views.to_map(view, uv)
    top = np.array([width, height]) - 1.0
    inside = ((xy >= -0.5) & (xy <= top + 0.5)).all(-1)
    xy = np.clip(xy, 0, top)
    nearest = np.rint(xy).astype(np.int64)
    at = (view * height + nearest[..., 1]) * width + nearest[..., 0]
    inverse = views.inverse_depth.reshape(-1)
    low = np.minimum(xy.astype(np.int64), top.astype(np.int64) - 1)
    corner = (view * height + low[..., 1]) * width + low[..., 0]
    a, b, c, d = (inverse[corner + offset] for offset in (0, 1, width, width + 1))
    fx, fy = np.moveaxis(xy - low, -1, 0)
    blend = (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * d)
    value = np.where((a > 0) & (b > 0) & (c > 0) & (d > 0), blend, inverse[at])
    good = inside & views.usable.reshape(-1)[at]
    return np.asarray(np.divide(1.0, value, out=np.zeros(value.shape), where=good))


def sight(views: DenseViews, p_s: Float, tolerance: float) -> Sightings:
    """Project points (M, 3), sub-map frame, into all views and compare with their depth D.

    A view agrees if |z - D(u)| <= tolerance D(u) (paper VI-A.1). Of views without depth uv is 0.
    """
    shape = len(p_s), len(views.cameras)
    found = Sightings(
        np.zeros((*shape, 2), np.float32), np.zeros(shape, bool), np.zeros(shape, bool)
    )
    T_c_s = se3.inverse(views.T_s_c)
    for camera, of_camera in _views_by_camera(views).items():
        T = T_c_s[of_camera]
        p_c = np.moveaxis(T[:, :3, :3] @ p_s.T + T[:, :3, 3:], 2, 0)
        z, uv = p_c[..., 2], camera.project(p_c)
        seen = sample(views, np.broadcast_to(of_camera, z.shape), uv)
        known = (seen > 0) & camera.within_reach(p_c)
        found.uv[:, of_camera] = np.clip(uv, -1e6, 1e6)
        found.agrees[:, of_camera] = known & (np.abs(z - seen) <= tolerance * seen)
        found.floats[:, of_camera] = known & (z < (1 - tolerance) * seen)
    return found


def _views_by_camera(views: DenseViews) -> dict[Camera, Int]:
    """Indices of the views that have depth, by their camera."""
    found: dict[Camera, list[int]] = {}
    for view in np.flatnonzero(views.usable.any((1, 2))).tolist():
        found.setdefault(views.cameras[view], []).append(view)
    return {camera: np.array(of_camera) for camera, of_camera in found.items()}


def confirmed(sightings: Sightings, own_view: Int) -> Bool:
    """Mask (M,) of verified points: confirmed by other views, at least as many as contradict them.

    own_view: (M,) view from which each point was back-projected. A view contradicts a point if its
    depth is larger; one in which the point is occluded counts neither way.
    """
    others = sightings.agrees.copy()
    others[np.arange(len(own_view)), own_view] = False
    n = others.sum(1)
    return np.asarray((n >= 1) & (n >= sightings.floats.sum(1)))
