"""Images of a point cloud: the top view, and perspective views from behind the car.

Images are (H, W, 3) uint8 RGB. Lengths are in the unit of the map. The *level frame* has z up
and x along the longer side of the drive (`level_rotation`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.types import Bytes, Float

PAPER = (245, 246, 248)
MAX_RADIUS_PX = 6
_EMPTY = np.iinfo(np.int64).max


@dataclass(frozen=True, slots=True)
class TopDown:
    """A top view and its placement in the level frame.

    origin: (2,) x of the left edge and y of the top edge. pixel: size of a pixel."""

    image: Bytes
    origin: Float
    pixel: float

    def to_pixels(self, p_level: Float) -> Float:
        """Pixels (..., 2) of points (..., 3) in the level frame."""
        return np.asarray((p_level[..., :2] - self.origin) * [1, -1] / self.pixel)


def level_rotation(T_w_c: Float) -> Float:
    """Rotation world -> level frame (3, 3) from camera poses (N, 4, 4), N >= 1.

    Up is the mean up axis of the camera over the drive, which averages out slopes and pitching.
    """
    up = -T_w_c[:, :3, 1].mean(0)
    up /= np.linalg.norm(up)
    p = T_w_c[:, :3, 3] - T_w_c[:, :3, 3].mean(0)
    flat = p - np.outer(p @ up, up)
    x = np.linalg.svd(flat, full_matrices=False)[2][0] if len(flat) > 1 else T_w_c[0, :3, 0]
    x = x - (x @ up) * up
    if np.linalg.norm(x) < 1e-9:
        x = np.cross(up, [1.0, 0.3, 0.2])
    if x @ (p[-1] - p[0]) < 0:
        x = -x
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(up, x), up])


def splat(uv: Float, depth: Float, radius: Float, color: Bytes, size: tuple[int, int]) -> Bytes:
    """Render points as squares with a z-buffer.

    uv: (N, 2) px. depth: (N,) any unit. radius: (N,) half size of a square, px. color: (N, 3).
    size: (width, height).
    """
    width, height = size
    buffer = np.full(width * height, _EMPTY, np.int64)
    channels = color.astype(np.int64)
    paint = (channels[:, 0] << 16) | (channels[:, 1] << 8) | channels[:, 2]
    low, high = (float(depth.min()), float(depth.max())) if len(depth) else (0.0, 1.0)
    level = ((depth - low) / max(high - low, 1e-12) * (1 << 30)).astype(np.int64)
    key = (level << 24) | paint
    column, row = np.floor(uv).astype(np.int64).T
    r = np.clip(np.floor(radius), 0, MAX_RADIUS_PX).astype(np.int64)
    for reach in range(int(r.max()) + 1 if len(r) else 0):
        who = np.flatnonzero(r >= reach)
        ring = range(-reach, reach + 1)
        for dx, dy in ((x, y) for x in ring for y in ring if max(abs(x), abs(y)) == reach):
            x, y = column[who] + dx, row[who] + dy
            inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
            np.minimum.at(buffer, y[inside] * width + x[inside], key[who[inside]])
    image = np.empty((width * height, 3), np.uint8)
    image[:] = PAPER
    seen = buffer != _EMPTY
    rgb = buffer[seen] & 0xFFFFFF
    image[seen] = np.stack([rgb >> 16, (rgb >> 8) & 255, rgb & 255], 1)
    return image.reshape(height, width, 3)


def _path_offsets(points: Float, path: Float) -> tuple[Float, Float]:
    """Horizontal distance (N,) of points (N, 3) to the path, and height (N,) above it.

    Level frame.
    """
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(path[:, :2]).query(points[:, :2], workers=-1)
    return np.asarray(distance), np.asarray(points[:, 2] - path[nearest, 2])


def top_down(points: Float, color: Bytes, path: Float, width: int = 1800) -> TopDown:
    """Render the top view of points (N, 3) with colours, level frame.

    The image covers the path (P, 3) with a margin, the 90 % quantile of the points' distances to
    it. The highest 2 % of the points are left out. So outliers neither enlarge the area nor hide
    the street.
    """
    distance, above = _path_offsets(points, path)
    reach = float(np.quantile(distance, 0.9))
    ceiling = float(np.quantile(above, 0.98))
    low, high = path[:, :2].min(0) - reach, path[:, :2].max(0) + reach
    pixel = float((high - low).max()) / width
    size = np.maximum(np.ceil((high - low) / pixel), 1).astype(int)
    view = TopDown(np.zeros((0, 0, 3), np.uint8), np.array([low[0], high[1]]), pixel)
    keep = (distance <= 1.2 * reach) & (above <= ceiling)
    uv = view.to_pixels(points[keep])
    radius = np.full(len(uv), 1.0 if len(uv) < 1.5 * size[0] * size[1] else 0.0)
    image = splat(uv, -points[keep, 2], radius, color[keep], (int(size[0]), int(size[1])))
    return TopDown(image, view.origin, pixel)


def eye_height(points: Float, path: Float) -> float:
    """Height of the camera above the road, from points beside the path, level frame."""
    distance, above = _path_offsets(points, path)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    near = above[(distance < 3 * max(float(np.median(steps)), 1e-6)) & (above < 0)]
    return float(-np.median(near)) if len(near) else float(np.quantile(np.abs(above), 0.5))


def chase(
    points: Float,
    color: Bytes,
    path: Float,
    index: int,
    height: float,
    size: tuple[int, int] = (1200, 560),
) -> Bytes:
    """Render points from behind and above the car at path[index], looking along the path.

    points, path: level frame. height: from `eye_height`; the viewpoint is 5 heights behind and
    3.2 heights above the camera.
    """
    ahead = path[min(index + max(len(path) // 40, 3), len(path) - 1)] - path[max(index - 2, 0)]
    forward = np.array([ahead[0], ahead[1], 0.0])
    forward /= max(float(np.linalg.norm(forward)), 1e-12)
    eye = path[index] - 5 * height * forward + np.array([0, 0, 3.2 * height])
    z = forward - np.array([0, 0, 0.28])
    z /= np.linalg.norm(z)
    x = np.cross(z, [0.0, 0.0, 1.0])
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(z, x), z])
    p = (points - eye) @ R.T
    p, rgb = p[(keep := (p[:, 2] > 2 * height) & (p[:, 2] < 60 * height))], color[keep]
    focal = 0.75 * size[0]
    uv = focal * p[:, :2] / p[:, 2:] + [size[0] / 2, 0.42 * size[1]]
    # half size in px of a square that is a tenth of `height` wide
    radius = focal * height / 20 / p[:, 2]
    return splat(uv, p[:, 2], radius, rgb, size)


def best_chases(points: Float, color: Bytes, path: Float, count: int = 2) -> list[Bytes]:
    """Render eight `chase` views along the path; return the `count` with most filled pixels."""
    thin = max(len(points) // 200_000, 1)
    few, few_colors = points[::thin], color[::thin]
    height = eye_height(few, path)
    tries = np.unique(np.linspace(0, 0.85 * (len(path) - 1), 8).astype(int))
    small = (240, 112)
    filled = [
        int((chase(few, few_colors, path, int(i), height, small) != PAPER).any(2).sum())
        for i in tries
    ]
    chosen = sorted(tries[np.argsort(filled, kind="stable")[-count:]])
    return [chase(points, color, path, int(i), height) for i in chosen]
