"""Exact matches of a batch: surface points and their pixels in the views that see them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float, Int

Bool = NDArray[np.bool_]

# Largest ratio between the distances of a point in two views for which a matcher works.
MAX_ZOOM = 2.5


@dataclass(frozen=True, slots=True)
class Sightings:
    """M surface points and their exact pixels in N views.

    p_w: (M, 3) world units. seeded_by: (M,) index of the view whose grid contains the point. uv:
    (N, M, 2) px. depth: (N, M) z-depth. seen: (N, M) whether visible.
    """

    p_w: Float
    seeded_by: Int
    uv: Float
    depth: Float
    seen: Bool


def project_all(cameras: Sequence[Camera], T_w_c: Float, p_w: Float) -> tuple[Float, Float]:
    """Project points (M, 3) into N views T_w_c (N, 4, 4): pixels (N, M, 2), z-depths (N, M).

    Pixels are -1 beyond the limit of a lens.
    """
    T_c_w = se3.inverse(T_w_c)
    p_c = p_w @ np.swapaxes(T_c_w[:, :3, :3], 1, 2) + T_c_w[:, None, :3, 3]
    uv = np.stack([_projected(camera, p) for camera, p in zip(cameras, p_c, strict=True)])
    return uv, p_c[..., 2]


def _projected(camera: Camera, p_c: Float) -> Float:
    uv = camera.project(p_c)
    return uv if camera.is_pinhole else np.where(camera.within_reach(p_c)[:, None], uv, -1.0)


def inside(uv: Float, size: Int) -> Bool:
    """Whether pixels (N, M, 2) lie inside the pictures of N views: (N, M). size: (N, 2) px."""
    return np.asarray((uv >= 0).all(-1) & (uv <= size[:, None] - 1).all(-1))


def sightings(
    p_w: Float, seeded_by: Int, cameras: Sequence[Camera], T_w_c: Float, size: Int, max_zoom: float
) -> Sightings:
    """Project points (M, 3) into all views and find where they are visible.

    seeded_by: (M,) view whose grid contains the point. max_zoom: a point is visible only if its
    distance differs by at most this factor from that in this view.
    """
    uv, depth = project_all(cameras, T_w_c, p_w)
    at_seed = depth[seeded_by, np.arange(len(p_w))]
    zoom = depth / at_seed
    seen = (depth > 0.1) & inside(uv, size) & (zoom < max_zoom) & (zoom > 1 / max_zoom)
    return Sightings(p_w, seeded_by, uv, depth, seen)


def grid_pixels(
    width: int, height: int, grid: tuple[int, int], jitter: np.random.Generator | None
) -> Float:
    """Pixels (R * C, 2) of a grid: the centres of its cells, or random positions in them."""
    rows, columns = grid
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float64)
    place = 0.5 if jitter is None else jitter.uniform(0, 1, (2, rows, columns))
    uv = np.stack([u, v]) + place
    return np.asarray(
        (uv * np.array([width / columns, height / rows])[:, None, None]).reshape(2, -1).T
    )
