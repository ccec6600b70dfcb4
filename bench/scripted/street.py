"""Street along a path: ground, facades on both sides, and sky above the roofs.

All surfaces are height or distance fields over the plane (x, z). Rays are intersected with them in
a few steps (sphere tracing: Hart, 1996). Crossing roads share their junction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from calm_edge.types import Float, Float32

CAMERA_HEIGHT_M = 1.65
MAX_RANGE_M = 120.0
# Size of a cell, and margin of the grid around the path, wide enough for all facades.
_CELL_M = 1.0
_MARGIN_M = 30.0
# Ranges of the distance of facades from the path and of roof heights, which vary over _BLOCK_M.
_FACADE_M = (4.5, 13.0)
_ROOF_M = (2.5, 9.0)
_BLOCK_M = 8.0
# Largest slope of the ground for which a step of sphere tracing is safe.
_GRADE = 0.3
_STRIDES = 64
_TOUCH_M = 0.01


@dataclass(frozen=True, slots=True)
class Street:
    """Height and distance fields (H, W) of a street, with cells of _CELL_M and rows along z.

    World units, y down. origin: (2,) x and z of cell (0, 0). clear: signed distance to the nearest
    facade, negative inside. ground, roof: y coordinates.
    """

    origin: Float
    clear: Float32
    ground: Float32
    roof: Float32

    @classmethod
    def along(cls, T_w_p: Float, seed: int = 0) -> Street:
        """Build the street along primary poses T_w_p (N, 4, 4), N >= 2, world units."""
        path = _dense(T_w_p[:, :3, 3])
        origin = path[:, [0, 2]].min(0) - _MARGIN_M
        cells = np.round((path[:, [0, 2]] - origin) / _CELL_M).astype(np.int64)
        width, height = cells.max(0) + int(_MARGIN_M / _CELL_M) + 1
        lowest = np.full((height, width), -np.inf)
        np.maximum.at(lowest, (cells[:, 1], cells[:, 0]), path[:, 1])
        away, nearest = ndimage.distance_transform_edt(
            np.isneginf(lowest), sampling=_CELL_M, return_indices=True
        )
        rng = np.random.default_rng(seed)
        facade = _varied(rng, (height, width), *_FACADE_M)
        inside = away < facade
        clear = ndimage.distance_transform_edt(inside, sampling=_CELL_M)
        clear -= ndimage.distance_transform_edt(~inside, sampling=_CELL_M)
        # where the path crosses itself at another height, the ground stays below both levels
        ground = ndimage.maximum_filter(lowest[tuple(nearest)], int(7 / _CELL_M))
        ground = ndimage.gaussian_filter(ground, 2.0 / _CELL_M) + CAMERA_HEIGHT_M
        roof = ground - _varied(rng, (height, width), *_ROOF_M)
        return cls(
            origin=origin,
            clear=ndimage.gaussian_filter(clear, 1.0).astype(np.float32),
            ground=ground.astype(np.float32),
            roof=roof.astype(np.float32),
        )

    def depth(self, rays_w: Float, centre_w: Float) -> Float:
        """Depth (...) along rays (..., 3) from centres (..., 3), as a multiple of the ray's length.

        inf for sky and beyond MAX_RANGE_M.
        """
        rays = rays_w.reshape(-1, 3)
        centre = np.broadcast_to(centre_w, rays_w.shape).reshape(-1, 3)
        level = np.hypot(rays[:, 0], rays[:, 2])
        sinking = rays[:, 1] + _GRADE * level
        along = np.zeros(len(rays))
        out = np.full(len(rays), np.inf)
        going = np.arange(len(rays))
        for _ in range(_STRIDES):
            p = centre[going] + along[going, None] * rays[going]
            clear, above = self._at(self.clear, p), self._at(self.ground, p) - p[:, 1]
            wall, floor = clear < _TOUCH_M, above < _TOUCH_M
            sky = wall & ~floor & (p[:, 1] < self._at(self.roof, p))
            done = wall | floor
            out[going[done & ~sky]] = along[going[done & ~sky]]
            going, clear, above = going[~done], clear[~done], above[~done]
            if not len(going):
                break
            fall = np.where(sinking[going] > 1e-6, above / np.maximum(sinking[going], 1e-6), 1e9)
            along[going] += np.minimum(clear / np.maximum(level[going], 1e-6), fall)
            going = going[along[going] < MAX_RANGE_M]
        return out.reshape(rays_w.shape[:-1])

    def _at(self, field: Float32, p_w: Float) -> Float:
        """Interpolate a field bilinearly at points (M, 3), clamped at its border: (M,)."""
        height, width = field.shape
        x = np.clip((p_w[:, 0] - self.origin[0]) / _CELL_M, 0, width - 1.001)
        z = np.clip((p_w[:, 2] - self.origin[1]) / _CELL_M, 0, height - 1.001)
        column, row = x.astype(np.int64), z.astype(np.int64)
        x, z = x - column, z - row
        flat, at = field.ravel(), row * width + column
        near = flat[at] * (1 - x) + flat[at + 1] * x
        far = flat[at + width] * (1 - x) + flat[at + width + 1] * x
        return np.asarray(near * (1 - z) + far * z, np.float64)


def _dense(p: Float) -> Float:
    """Resample the polyline p (N, 3) to steps of at most half a cell."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], int(along[-1] / (_CELL_M / 2)) + 2)
    return np.stack([np.interp(at, along, p[:, axis]) for axis in range(3)], -1)


def _varied(rng: np.random.Generator, shape: tuple[int, int], low: float, high: float) -> Float:
    """Random values (H, W) between low and high that vary smoothly over _BLOCK_M."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), _BLOCK_M / _CELL_M, mode="wrap")
    share = 0.5 + 0.5 * np.tanh(noise / noise.std())
    return np.asarray(low + (high - low) * share)
