"""Pictures through any lens whose rows are exposed one after the other, of a scene that may move.

As in `render`, surfaces are cut to pieces and drawn into a z-buffer. Here every pixel has a ray of
its own, by the lens, from an origin of its own, by the instant of its row, and is intersected with
the plane of the piece: exact for any lens and motion, apart from the texture's interpolation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from tests.synthetic.render import (
    NEAR_M,
    Pieces,
    Scene,
    hazy,
    joined,
    mip_level,
    sky_colors,
    visible_pieces,
)
from tests.synthetic.surface import Texture
from tests.synthetic.textures import Image

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
# share of its sides by which a piece is drawn larger, so that no crack is left beside the next one
OVERLAP = 1e-4
# nodes (u, v) of a piece whose projections give its box in the picture
NODES = np.stack(np.meshgrid([0, 0.5, 1], [0, 0.5, 1]), -1).reshape(-1, 2)


@dataclass(frozen=True, slots=True)
class Part:
    """A rigid part of what is seen. T_part_c: (H, 4, 4) camera -> part when each row is exposed."""

    scene: Scene
    T_part_c: Float


@dataclass(frozen=True, slots=True)
class View:
    """image: (H, W, 3) uint8 BGR. depth: (H, W) m along z of the row's camera, 0 where sky.

    part: (H, W) index of the part seen, -1 where sky.
    """

    image: Image
    depth: Float32
    part: Int32


@dataclass(frozen=True, slots=True)
class _Lens:
    """Rays (x, y, 1) of all pixels (H, W).

    slopes: (H, W, 4) px^-1, of x by column and row, then of y.
    rim: (4, 3) as `picture_rim`, with a margin. reach: largest angle off the axis, rad, with one.
    """

    x: Float32
    y: Float32
    slopes: Float
    rim: Float
    reach: float


@lru_cache(maxsize=8)
def _lens(camera: Camera) -> _Lens:
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    q = camera.normalized(np.stack([columns, rows], -1).astype(np.float64))
    if not np.isfinite(q).all():
        raise ValueError(f"{camera}: some pixels have no ray; choose a smaller field of view")
    slopes = np.stack([np.gradient(q[..., k], axis=axis) for k in (0, 1) for axis in (1, 0)], -1)
    low, high = q.min((0, 1)), q.max((0, 1))
    # what is outside when the middle row is exposed may be inside at another one
    low, high = low - 0.1 - 0.1 * np.abs(low), high + 0.1 + 0.1 * np.abs(high)
    rim = np.array([[1, 0, -low[0]], [-1, 0, high[0]], [0, 1, -low[1]], [0, -1, high[1]]])
    widest = float(np.arctan(np.linalg.norm(q, axis=-1).max()))
    reach = min(widest + np.radians(3), camera.max_angle - 1e-6, np.radians(89.5))
    return _Lens(
        q[..., 0].astype(np.float32), q[..., 1].astype(np.float32), slopes, rim, float(reach)
    )


class _Motion:
    """Of the camera while rows are exposed, in its own axes at the middle row.

    R: (H, 3, 3), o: (H, 3) of each row's camera; T_c_part: (4, 4) of the middle row.
    """

    def __init__(self, T_part_c: Float) -> None:
        self.T_c_part = se3.inverse(T_part_c[len(T_part_c) // 2])
        T = self.T_c_part @ T_part_c
        self.R, self.o = T[:, :3, :3], T[:, :3, 3]
        self.ends = se3.inverse(T[[0, len(T) // 2, -1]])
        self.most_m = float(np.linalg.norm(self.o, axis=1).max())


def _boxes(pieces: Pieces, motion: _Motion, camera: Camera, reach: float) -> Float:
    """(P, 4) left, top, right, foot, px, of where pieces may be seen."""
    u, v = NODES[:, :1], NODES[:, 1:]
    p = pieces.origin[:, None] + u * pieces.along[:, None] + v * pieces.down[:, None]
    p = np.concatenate([se3.transform(T, p) for T in motion.ends], 1)
    # the lens has no pixels there: such points are taken to just beyond the picture
    beyond = np.arctan2(np.hypot(p[..., 0], p[..., 1]), p[..., 2]) > reach
    azimuth = np.arctan2(p[..., 1], p[..., 0])[beyond]
    across = np.sin(reach) * np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
    p[beyond] = np.c_[across, np.full_like(azimuth, np.cos(reach))]
    uv = camera.project(p)
    low, high = uv.min(1), uv.max(1)
    # lines between the nodes are curved
    margin = 2 + 0.04 * (high - low).max(1, keepdims=True)
    return np.concatenate([low - margin, high + margin], 1)


class _Drawing:
    """A picture being drawn, `oversample` times finer than the camera's."""

    def __init__(
        self, camera: Camera, sky: Image, motions: Sequence[_Motion], oversample: int
    ) -> None:
        self.camera, self.motions = camera.scaled(oversample, oversample), motions
        self.lens = _lens(self.camera)
        self.size = self.camera.width, self.camera.height
        fine = cv2.resize(sky, self.size, interpolation=cv2.INTER_LINEAR)
        self.image = np.asarray(fine, np.uint8)
        self.nearness = np.zeros(self.size[::-1], np.float32)
        self.owner = np.full(self.size[::-1], -1, np.int32)
        # the camera's row that each fine one is a part of
        self.row = np.arange(self.size[1]) // oversample

    def draw(self, pieces: Pieces, part: Int64, textures: Sequence[Texture]) -> None:
        """Draw pieces, nearest first. part: (P,) index of their motions; textures: of surfaces."""
        boxes = np.empty((len(part), 4))
        for k, motion in enumerate(self.motions):
            boxes[part == k] = _boxes(pieces.take(part == k), motion, self.camera, self.lens.reach)
        low = np.maximum(np.floor(boxes[:, :2]), 0).astype(int)
        high = np.minimum(np.ceil(boxes[:, 2:]) + 1, self.size).astype(int)
        nearest = pieces.corners()[..., 2].min(1)
        normal = np.cross(pieces.along, pieces.down)
        # from an origin to the piece's: W -> (V x W, W x U, n W)
        solve = np.concatenate(
            [
                np.swapaxes(se3.hat(pieces.down), 1, 2),
                -np.swapaxes(se3.hat(pieces.along), 1, 2),
                normal[..., None],
            ],
            2,
        )
        for k in np.flatnonzero((high > low).all(1)).tolist():
            motion = self.motions[part[k]]
            (x0, y0), (x1, y1) = low[k].tolist(), high[k].tolist()
            box = np.s_[y0:y1, x0:x1]
            seen = self.nearness[box]
            if seen.min() * max(0.98 * nearest[k] - motion.most_m, NEAR_M) > 1:
                continue
            rows = self.row[y0:y1]
            solved = (pieces.origin[k] - motion.o[rows]) @ solve[k]
            solved = np.concatenate([solved, np.tile(normal[k], (len(rows), 1))], 1)
            vectors = solved[:, [0, 1, 2, 3, 4, 5, 7, 8, 9]].reshape(-1, 3, 3) @ motion.R[rows]
            a, b, n = np.moveaxis(vectors, 1, 0).astype(np.float32)[..., None]
            x, y = self.lens.x[box], self.lens.y[box]
            slope = n[:, 0] * x + n[:, 1] * y + n[:, 2]
            near = slope / solved[:, 6:7].astype(np.float32)
            closer = cv2.compare(near, seen, cv2.CMP_GT)
            closer = cv2.bitwise_and(closer, cv2.compare(near, 1 / NEAR_M, cv2.CMP_LT))
            if not cv2.hasNonZero(closer):
                continue
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                u = (a[:, 0] * x + a[:, 1] * y + a[:, 2]) / slope
                v = (b[:, 0] * x + b[:, 1] * y + b[:, 2]) / slope
            for t in (u, v):
                closer = cv2.bitwise_and(closer, cv2.inRange(t, -OVERLAP, 1 + OVERLAP))
            if cv2.hasNonZero(closer):
                texture = textures[pieces.surface[k]]
                closer = self._paint(texture, pieces, k, box, (u, v), closer)
                cv2.copyTo(near, closer, seen)
                self.owner[box][closer > 0] = k

    def _paint(
        self,
        texture: Texture,
        pieces: Pieces,
        k: int,
        box: tuple[slice, slice],
        uv: tuple[Float32, Float32],
        closer: Image,
    ) -> Image:
        """Draw piece k where `closer` allows and its texture is opaque; returns where it did."""
        left, top, width, height = cv2.boundingRect(closer)
        row, column = box[0].start + top + height // 2, box[1].start + left + width // 2
        x, y = float(self.lens.x[row, column]), float(self.lens.y[row, column])
        xx, xy, yx, yy = self.lens.slopes[row, column].tolist()
        # the pinhole that the lens is near that pixel
        ray = np.array(
            [[xx, xy, x - xx * column - xy * row], [yx, yy, y - yx * column - yy * row], [0, 0, 1]]
        )
        u0, v0, du, dv = pieces.uv[k]
        along, down = pieces.along[k] / du, pieces.down[k] / dv
        origin = pieces.origin[k] - along * u0 - down * v0
        M = np.linalg.inv(np.stack([along, down, origin], 1)) @ ray
        texels = texture.level(*mip_level(texture, M, np.array([column, row])))
        rows, columns = texels.shape[:2]
        drawn = cv2.remap(
            texels,
            uv[0] * np.float32(du * columns) + np.float32(u0 * columns - 0.5),
            uv[1] * np.float32(dv * rows) + np.float32(v0 * rows - 0.5),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        if drawn.ndim == 3 and drawn.shape[2] == 4:
            _, opaque = cv2.threshold(cv2.extractChannel(drawn, 3), 127, 255, cv2.THRESH_BINARY)
            closer = cv2.bitwise_and(closer, opaque)
            drawn = cv2.cvtColor(drawn, cv2.COLOR_BGRA2BGR)
        cv2.copyTo(drawn, closer, self.image[box])
        return np.asarray(closer, np.uint8)


def _depth(
    pieces: Pieces, owner: Int64, part: Int64, motions: Sequence[_Motion], camera: Camera
) -> Float32:
    """(H, W) depths of the pieces `owner` (H, W) at the centres of the camera's pixels."""
    lens = _lens(camera)
    rays = np.stack([lens.x, lens.y, np.ones_like(lens.x)], -1)
    normal = np.cross(pieces.along, pieces.down)
    depth = np.zeros(owner.shape, np.float32)
    for p, motion in enumerate(motions):
        row, column = np.nonzero((owner >= 0) & (part[owner] == p))
        k = owner[row, column]
        ray = (motion.R[row] @ rays[row, column][..., None])[..., 0]
        distance = ((pieces.origin[k] - motion.o[row]) * normal[k]).sum(-1)
        inverse = (ray * normal[k]).sum(-1) / distance
        depth[row, column] = np.where(inverse > 1e-6, 1 / np.maximum(inverse, 1e-6), 0)
    return depth


def render_rows(parts: Sequence[Part], camera: Camera, oversample: int = 2) -> View:
    """One picture of parts[0], which has the sky, and of those that move in it.

    Depth and part are those of the surface at a pixel's upper left sample, the depth exactly at the
    pixel's centre.
    """
    motions = [_Motion(p.T_part_c) for p in parts]
    rim = _lens(camera).rim
    of_part, textures = [], []
    for part, motion in zip(parts, motions, strict=True):
        found = visible_pieces(part.scene, motion.T_c_part, rim)
        of_part.append(replace(found, surface=found.surface + len(textures)))
        textures += part.scene.textures
    owners = np.repeat(np.arange(len(parts)), [len(p.surface) for p in of_part])
    pieces = joined(of_part)
    order = np.argsort(pieces.corners()[..., 2].min(1), kind="stable")
    pieces, owners = pieces.take(order), owners[order]
    lens = _lens(camera)
    rays = np.stack([lens.x, lens.y, np.ones_like(lens.x)], -1).astype(np.float64)
    R_w_c = parts[0].T_part_c[:, :3, :3]
    sky = sky_colors(parts[0].scene.sky, rays @ np.swapaxes(R_w_c, 1, 2))
    drawing = _Drawing(camera, sky, motions, oversample)
    drawing.draw(pieces, owners, textures)
    size = camera.width, camera.height
    picture = np.asarray(cv2.resize(drawing.image, size, interpolation=cv2.INTER_AREA), np.uint8)
    owner = drawing.owner[::oversample, ::oversample].astype(np.int64)
    depth = _depth(pieces, owner, owners, motions, camera)
    part_seen = np.where(owner >= 0, owners[owner], -1).astype(np.int32)
    return View(hazy(picture, depth), depth, part_seen)
