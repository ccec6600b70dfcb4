"""Synthetic street of planes and spheres with exact depth, seen by two driving cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.mapping.views import DenseViews, prepare
from calm_edge.types import Float, Submap

IMAGE = (320, 192)
DEPTH = (160, 96)
SPACING = 0.5
STEP = 0.8
T_P_A = se3.exp(np.array([SPACING, 0.0, 0.0, 0.0, np.radians(2.0), 0.0]))
Warp = Callable[[Float], Float]


@dataclass(frozen=True)
class Scene:
    """Planes n.x = d: normals (P, 3), offsets (P,). Spheres: centres (S, 3), radii (S,)."""

    normals: Float
    offsets: Float
    centres: Float
    radii: Float

    def depth(self, camera: Camera, T_w_c: Float) -> Float:
        """Exact z-depth (h, w) of the camera's pixels."""
        u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
        ray_c = camera.back_project(np.stack([u, v], -1).astype(float), np.ones(u.shape))
        ray = ray_c @ T_w_c[:3, :3].T
        origin = T_w_c[:3, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self.offsets - self.normals @ origin) / (ray @ self.normals.T)
            q = origin - self.centres
            a = (ray**2).sum(-1)[..., None]
            b = ray @ q.T
            root = b**2 - a * ((q**2).sum(-1) - self.radii**2)
            s = (-b - np.sqrt(root)) / a
        hits = np.concatenate([t, s], -1)
        return np.where(hits > 0.05, hits, np.inf).min(-1)


def street(seed: int) -> Scene:
    """Ground, two walls and an end wall, each randomly tilted, and spheres along the kerb."""
    rng = np.random.default_rng(seed)
    normals = np.array([[0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1.0]])
    normals += rng.normal(0, 0.02, normals.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    z = np.linspace(6, 50, 12)
    side = np.where(np.arange(12) % 2, 4.5, -4.5) + rng.normal(0, 0.5, 12)
    centres = np.stack([side, rng.uniform(0, 1.2, 12), z], -1)
    return Scene(normals, np.array([1.5, 7.0, 7.0, 60.0]), centres, rng.uniform(0.6, 1.4, 12))


def pose_on_street(index: int) -> Float:
    """Pose T_w_c of primary keyframe `index` on a slightly curved path."""
    return se3.exp(np.array([0.0, 0.0, STEP * index, 0.0, np.radians(0.4 * index), 0.0]))


@dataclass(frozen=True)
class Piece:
    """A sub-map with depth (raw unit), confidence and images as from a backbone."""

    submap: Submap
    depth: NDArray[np.float32]
    confidence: NDArray[np.float32]
    images: list[NDArray[np.uint8]]

    def views(self, max_range: float = 30.0) -> DenseViews:
        sizes = np.array([image.shape[1::-1] for image in self.images])
        return prepare(self.submap, self.depth, self.confidence, sizes, 0.5, max_range)


def piece(
    scene: Scene,
    submap_id: int,
    keyframes: list[int],
    *,
    scale: float = 1.0,
    loop: int | None = None,
    warp: Warp | None = None,
    pose: Callable[[int], Float] = pose_on_street,
) -> Piece:
    """Primary and assistant views of `keyframes` (and a loop keyframe) as one sub-map.

    warp: true points (..., 3), sub-map frame -> relative depth error (...).
    """
    primary = [pose(i) for i in keyframes]
    T_w_c = np.array([*primary, *(T @ T_P_A for T in primary)])
    t_ns = [i * 10**8 for i in keyframes] * 2
    if loop is not None:
        T_w_c, t_ns = np.array([*T_w_c, pose(loop)]), [*t_ns, loop * 10**8]
    T_w_s = primary[0]
    T_s_c = se3.inverse(T_w_s) @ T_w_c
    eyes = [70.0] * len(keyframes) + [60.0] * len(keyframes) + [70.0] * (loop is not None)
    cameras = tuple(Perspective.from_hfov(h, *IMAGE) for h in eyes)
    small = [camera.scaled(DEPTH[0] / IMAGE[0], DEPTH[1] / IMAGE[1]) for camera in cameras]
    depth = np.array([scene.depth(k, T) for k, T in zip(small, T_w_c, strict=True)])
    if warp is not None:
        u, v = np.meshgrid(np.arange(DEPTH[0]), np.arange(DEPTH[1]))
        uv = np.stack([u, v], -1).astype(float)
        for n, (k, T) in enumerate(zip(small, T_s_c, strict=True)):
            p_s = se3.transform(T, k.back_project(uv, depth[n]))
            depth[n] *= 1 + warp(p_s)
    raw = T_s_c.copy()
    raw[:, :3, 3] /= scale
    ids = tuple(keyframes)
    submap = Submap(
        id=submap_id,
        primary_ids=ids,
        assistant_ids=ids,
        n_overlap=3,
        t_ns=np.array(t_ns),
        T_s_c_raw=raw,
        cameras_raw=cameras,
        T_s_c=T_s_c,
        cameras=cameras,
        scale=scale,
        T_w_s=T_w_s,
        focal_log_sigma=np.zeros(2),
    )
    depth = (depth / scale).astype(np.float32)
    image = np.full((IMAGE[1], IMAGE[0], 3), (10, 20, 30), np.uint8)
    return Piece(submap, depth, np.ones_like(depth), [image] * len(depth))


def chain(
    scene: Scene, n_submaps: int, n_views: int, warps: list[Warp] | None = None
) -> list[Piece]:
    """Sub-maps of n_views primary keyframes, overlapping by 3, each with a raw unit of its own."""
    pieces = []
    for k in range(n_submaps):
        first = k * (n_views - 3)
        warp = None if warps is None else warps[k % len(warps)]
        ids = list(range(first, first + n_views))
        pieces.append(piece(scene, k, ids, scale=1.0 + 0.5 * k, warp=warp))
    return pieces


def distance_to_scene(scene: Scene, points_w: Float) -> Float:
    """Distance (M,) of points to the nearest surface of the scene."""
    planes = np.abs(points_w @ scene.normals.T - scene.offsets)
    spheres = np.linalg.norm(points_w[:, None] - scene.centres, axis=-1) - scene.radii
    return np.concatenate([planes, np.abs(spheres)], -1).min(-1)
