"""A z-buffer of textured parallelograms: pictures with exact depth, in numpy and OpenCV.

Pixels: the centre of the top-left pixel is (0, 0). A surface is cut until perspective is mild
within each piece; each piece is one homography of the texture copy whose texels fit its pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera
from tests.synthetic.surface import Surface, Texture
from tests.synthetic.textures import Image

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
NEAR_M = 0.2
HAZE_M = 420.0
HAZE_COLOR = np.array([222, 214, 206], np.float32)


class Scene:
    """Surfaces as arrays, ready to be culled and drawn. sky: panorama, see `sky_colors`."""

    def __init__(self, surfaces: Sequence[Surface], sky: Image, reach_m: float = 170.0) -> None:
        self.origin = np.array([s.origin for s in surfaces], np.float64)
        self.along = np.array([s.along for s in surfaces], np.float64)
        self.down = np.array([s.down for s in surfaces], np.float64)
        self.two_sided = np.array([s.two_sided for s in surfaces], np.bool_)
        self.textures: list[Texture] = [s.texture for s in surfaces]
        self.sky = sky
        self.reach_m = reach_m


@dataclass(frozen=True, slots=True)
class Pieces:
    """Parts of surfaces in camera axes: (P, 3) each; surface, uv (P, 4): u0 v0 du dv."""

    surface: NDArray[np.int64]
    origin: Float
    along: Float
    down: Float
    uv: Float

    def corners(self) -> Float:
        """(P, 4, 3) in drawing order."""
        o, u, v = self.origin, self.along, self.down
        return np.stack([o, o + u, o + u + v, o + v], 1)

    def take(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> Pieces:
        """Some of them, or all in another order."""
        return Pieces(
            self.surface[keep], self.origin[keep], self.along[keep], self.down[keep], self.uv[keep]
        )

    def halves(self, along_u: NDArray[np.bool_]) -> Pieces:
        """Every piece in two, across u or across v."""
        u = np.where(along_u, 0.5, 1.0)[:, None]
        v = np.where(along_u, 1.0, 0.5)[:, None]
        half_u, half_v = self.along * u, self.down * v
        step = np.where(along_u[:, None], half_u, half_v)
        uv = self.uv * np.hstack([np.ones_like(u), np.ones_like(v), u, v])
        far = uv.copy()
        far[:, 0] += np.where(along_u, uv[:, 2], 0)
        far[:, 1] += np.where(along_u, 0, uv[:, 3])
        return Pieces(
            np.concatenate([self.surface, self.surface]),
            np.concatenate([self.origin, self.origin + step]),
            np.concatenate([half_u, half_u]),
            np.concatenate([half_v, half_v]),
            np.concatenate([uv, far]),
        )


def joined(parts: list[Pieces]) -> Pieces:
    """All pieces of a list."""
    names = ("surface", "origin", "along", "down", "uv")
    return Pieces(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))


def _in_view(p: Pieces, rim: Float) -> NDArray[np.bool_]:
    """Whether any part may lie in the view; rim (4, 3): inward normals of the image's edges."""
    c = p.corners()
    inside = (c @ rim.T).max(1) > 0
    return np.asarray(inside.all(1) & (c[..., 2].max(1) > NEAR_M))


def picture_rim(camera: Camera) -> Float:
    """(4, 3) inward normals of the planes through a pinhole and the edges of its picture."""
    fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
    return np.array(
        [
            [fx, 0, cx + 0.5],
            [-fx, 0, camera.width - 0.5 - cx],
            [0, fy, cy + 0.5],
            [0, -fy, camera.height - 0.5 - cy],
        ]
    )


def visible_pieces(scene: Scene, T_c_w: Float, rim: Float) -> Pieces:
    """Culled and cut pieces, nearest first. rim: (4, 3) planes of the view, as `picture_rim`."""
    R, t = T_c_w[:3, :3], T_c_w[:3, 3]
    n = len(scene.origin)
    p = Pieces(
        np.arange(n),
        scene.origin @ R.T + t,
        scene.along @ R.T,
        scene.down @ R.T,
        np.tile([0.0, 0, 1, 1], (n, 1)),
    )
    facing = np.einsum("ij,ij->i", np.cross(p.along, p.down), p.origin)
    keep = _in_view(p, rim) & ((facing > 1e-9) | (scene.two_sided & (np.abs(facing) > 1e-9)))
    p = p.take(keep & (p.corners()[..., 2].min(1) < scene.reach_m))
    done: list[Pieces] = []
    for _ in range(12):
        z = p.corners()[..., 2]
        cut = z.max(1) > 2.0 * np.maximum(z.min(1), NEAR_M)
        # below 30 cm a piece that still straddles the near plane is clipped, not cut
        longest = np.maximum(np.linalg.norm(p.along, axis=1), np.linalg.norm(p.down, axis=1))
        cut &= longest > 0.3
        done.append(p.take(~cut))
        p = p.take(cut)
        if not len(p.surface):
            break
        p = p.halves(np.abs(p.along[:, 2]) >= np.abs(p.down[:, 2]))
        p = p.take(_in_view(p, rim))
    p = joined([*done, p])
    return p.take(np.argsort(p.corners()[..., 2].min(1), kind="stable"))


def _clipped(corners: Float) -> Float:
    """The part of a convex polygon (4, 3) in front of the near plane, (n, 3)."""
    out = []
    for a, b in zip(corners, np.roll(corners, -1, 0), strict=True):
        if a[2] >= NEAR_M:
            out.append(a)
        if (a[2] >= NEAR_M) != (b[2] >= NEAR_M):
            out.append(a + (b - a) * ((NEAR_M - a[2]) / (b[2] - a[2])))
    return np.array(out).reshape(-1, 3)


def mip_level(texture: Texture, M: Float, centre: Float) -> tuple[int, int]:
    """How often to halve each axis so that a texel is about a pixel. M: pixel -> (u, v, 1) / z."""
    # plain floats: this runs for every piece, where numpy's call overhead would rule
    x, y = float(centre[0]), float(centre[1])
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = M.tolist()
    w = c0 * x + c1 * y + c2
    u, v = (a0 * x + a1 * y + a2) / w, (b0 * x + b1 * y + b2) / w
    ux, uy, vx, vy = (a0 - u * c0) / w, (a1 - u * c1) / w, (b0 - v * c0) / w, (b1 - v * c1) / w
    per_u, per_v = max(abs(ux), abs(uy)), max(abs(vx), abs(vy))
    # an oblique view of rotated texels would ask to blur both axes: blur by area at most
    slack = math.sqrt(min(1.0, 2 * abs(ux * vy - uy * vx) / max(per_u * per_v, 1e-18)))
    height, width = texture.base().shape[:2]
    lx = round(math.log2(max(per_u * slack * width, 1.0)))
    ly = round(math.log2(max(per_v * slack * height, 1.0)))
    return min(lx, int(math.log2(width))), min(ly, int(math.log2(height)))


def sky_colors(sky: Image, rays: Float) -> Image:
    """The panorama (azimuth across, elevation +90 .. -90 degrees down) along rays (H, W, 3)."""
    azimuth = np.arctan2(rays[..., 0], rays[..., 2])
    elevation = np.arctan2(-rays[..., 1], np.hypot(rays[..., 0], rays[..., 2]))
    map_x = (azimuth / (2 * np.pi) + 0.5) * sky.shape[1] - 0.5
    map_y = (0.5 - elevation / np.pi) * sky.shape[0] - 0.5
    out = cv2.remap(
        sky,
        map_x.astype(np.float32),
        map_y.astype(np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )
    return np.asarray(out, np.uint8)


def render_view(
    scene: Scene, T_w_c: Float, camera: Camera, oversample: int = 2
) -> tuple[Image, Float32]:
    """One picture: (H, W, 3) uint8 BGR and (H, W) float32 z-depth in metres, 0 where sky.

    T_w_c: (4, 4). Depth is that of the surface at the
    pixel's upper left sample, evaluated exactly at the pixel's centre.
    """
    width, height = camera.width, camera.height
    fine_camera = camera.scaled(oversample, oversample)
    fine = (width * oversample, height * oversample)
    T_c_w = np.asarray(np.linalg.inv(T_w_c), np.float64)
    pieces = visible_pieces(scene, T_c_w, picture_rim(fine_camera))
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    rays = camera.back_project(np.stack([x, y], -1), np.ones((height, width)))
    sky = sky_colors(scene.sky, rays @ T_w_c[:3, :3].T)
    image = cv2.resize(sky, fine, interpolation=cv2.INTER_LINEAR)
    nearness = np.zeros((fine[1], fine[0]), np.float32)
    owner = np.full((fine[1], fine[0]), -1, np.int32)

    corners = pieces.corners()
    # the whole surface's frame, so that one texture serves all of its pieces
    along = pieces.along / pieces.uv[:, 2:3]
    down = pieces.down / pieces.uv[:, 3:4]
    origin = pieces.origin - along * pieces.uv[:, :1] - down * pieces.uv[:, 1:2]
    M = np.linalg.inv(fine_camera.matrix @ np.stack([along, down, origin], 2))
    pixels = fine_camera.project(corners)
    z_min = corners[..., 2].min(1)
    columns = np.arange(fine[0], dtype=np.float64)
    rows = np.arange(fine[1], dtype=np.float64)
    for k, surface in enumerate(pieces.surface):
        outline = pixels[k]
        if z_min[k] < NEAR_M:
            outline = fine_camera.project(_clipped(corners[k]))
        (left, top), (right, foot) = outline.min(0).tolist(), outline.max(0).tolist()
        x0, y0 = max(0, math.floor(left) - 1), max(0, math.floor(top) - 1)
        x1, y1 = min(fine[0], math.ceil(right) + 2), min(fine[1], math.ceil(foot) + 2)
        if x1 <= x0 or y1 <= y0:
            continue
        seen = nearness[y0:y1, x0:x1]
        if seen.min() * max(z_min[k], NEAR_M) > 1:
            continue
        texture = scene.textures[surface]
        covered = np.zeros((y1 - y0, x1 - x0), np.uint8)
        polygon = np.clip((outline - (x0, y0)) * 16, -(2**20), 2**20).round().astype(np.int32)
        cv2.fillConvexPoly(covered, polygon, 255, lineType=cv2.LINE_8, shift=4)
        plane = M[k, 2]
        new = np.add.outer(
            (plane[1] * rows[y0:y1] + plane[2]).astype(np.float32),
            (plane[0] * columns[x0:x1]).astype(np.float32),
        )
        closer = cv2.bitwise_and(cv2.compare(new, seen, cv2.CMP_GT), covered)
        if not cv2.hasNonZero(closer):
            continue
        centre = np.minimum(np.maximum(outline.mean(0), 0), fine)
        texels = texture.level(*mip_level(texture, M[k], centre))
        to_texel = np.array([[texels.shape[1], 0, -0.5], [0, texels.shape[0], -0.5], [0, 0, 1.0]])
        shift = np.array([[1.0, 0, x0], [0, 1, y0], [0, 0, 1]])
        drawn = cv2.warpPerspective(
            texels,
            to_texel @ M[k] @ shift,
            (x1 - x0, y1 - y0),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
        if drawn.shape[2] == 4:
            _, opaque = cv2.threshold(cv2.extractChannel(drawn, 3), 127, 255, cv2.THRESH_BINARY)
            closer = cv2.bitwise_and(closer, opaque)
            drawn = cv2.cvtColor(drawn, cv2.COLOR_BGRA2BGR)
        cv2.copyTo(drawn, closer, image[y0:y1, x0:x1])
        cv2.copyTo(new, closer, seen)
        owner[y0:y1, x0:x1][closer > 0] = k

    picture = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    first = owner[::oversample, ::oversample]
    half = (oversample - 1) / 2
    to_fine = np.array([[oversample, 0, half], [0, oversample, half], [0, 0, 1.0]])
    planes = np.vstack([M[:, 2] @ to_fine, np.zeros(3)])
    a, b, c = np.moveaxis(planes[first], -1, 0)
    inverse = a * np.arange(width) + b * np.arange(height)[:, None] + c
    depth = np.where(inverse > 1e-6, 1 / np.maximum(inverse, 1e-6), 0).astype(np.float32)
    return hazy(picture, depth), depth


def hazy(picture: Image, depth: Float32) -> Image:
    """The picture (H, W, 3) with what is far paler. depth: (H, W) m, 0 where sky."""
    haze = np.where(depth > 0, 1 - np.exp(-depth / HAZE_M), 0)[..., None].astype(np.float32)
    return np.clip(picture * (1 - haze) + HAZE_COLOR * haze, 0, 255).astype(np.uint8)


def render_views(
    scene: Scene, T_w_c: Float, camera: Camera, oversample: int = 2
) -> tuple[list[Image], list[Float32]]:
    """`render_view` of poses (N, 4, 4)."""
    views = [render_view(scene, T, camera, oversample) for T in T_w_c]
    return [v[0] for v in views], [v[1] for v in views]
