"""Pictures of what a lens does: as taken and straightened, each with the same grid.

The grid's lines are straight in the scene. A perfect pinhole camera shows them straight; in the
picture as taken they are bent as the estimated lens bends them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.geometry.undistortion import undistortion
from calm_edge.types import Bytes, Float

WIDTH_PX = 480
# grid cells along the longer side, and points along one line
CELLS, POINTS = 12, 49
# RGB
LINE = (255, 214, 10)


@dataclass(frozen=True, slots=True)
class LensImage:
    """Pictures (h, w, 3) RGB as taken and straightened, and the lens in numbers.

    bend_px: the largest distance, at full size, between a point of the picture and where the
    pinhole camera with this focal length and centre would show it. cut: share of the picture that
    is not in the straightened one. terms: names and values of the lens.
    """

    taken: Bytes
    straight: Bytes
    bend_px: float
    cut: float
    terms: tuple[tuple[str, float], ...]


def lens_image(picture: Bytes, camera: Camera) -> LensImage:
    """Draw both pictures of a picture (H, W, 3) BGR of this camera, of any size."""
    height = max(1, round(WIDTH_PX * camera.height / camera.width))
    lens = camera.scaled(WIDTH_PX / camera.width, height / camera.height)
    maps = undistortion(lens)
    small = cv2.resize(picture, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
    taken = np.ascontiguousarray(small[..., ::-1], np.uint8)
    straight = cv2.remap(taken, maps.map_x, maps.map_y, cv2.INTER_LINEAR)
    lines = grid(WIDTH_PX, height)
    rays = maps.camera.rays(lines)
    seen = lens.project(rays)
    seen[~lens.within_reach(rays)] = np.nan
    return LensImage(
        _drawn(taken, seen),
        _drawn(np.asarray(straight, np.uint8), lines),
        bend_px(camera),
        maps.cut,
        tuple((f"k{n}", float(k)) for n, k in enumerate(camera.distortion, 1) if k),
    )


def grid(width: int, height: int) -> Float:
    """Pixels (L, POINTS, 2) along the horizontal and vertical lines of a grid over a picture."""
    cell = max(width, height) / CELLS
    x, y = np.linspace(0, width - 1, POINTS), np.linspace(0, height - 1, POINTS)
    across = [np.stack([x, np.full(POINTS, v)], 1) for v in np.arange(cell / 2, height, cell)]
    down = [np.stack([np.full(POINTS, u), y], 1) for u in np.arange(cell / 2, width, cell)]
    return np.array(across + down)


def bend_px(camera: Camera) -> float:
    """Largest displacement [px] by the lens within the picture, where the pinhole sees it."""
    pixels = camera.pixel_grid(33, 33)
    seen = camera.rays(pixels)[:, 2] > 0.2
    moved = np.linalg.norm(camera.undistorted(pixels[seen]) - pixels[seen], axis=1)
    return float(moved.max()) if len(moved) else 0.0


def _drawn(picture: Bytes, lines: Float) -> Bytes:
    drawn = picture.copy()
    for line in lines:
        known = line[np.isfinite(line).all(1)]
        # cv2 draws in sixteenths of a pixel; points far outside overflow its integers
        near = known[(np.abs(known) < 4 * WIDTH_PX).all(1)]
        points = np.rint(16 * near).astype(np.int32)[:, None]
        cv2.polylines(drawn, [points], False, LINE, 1, cv2.LINE_AA, 4)
    return drawn
