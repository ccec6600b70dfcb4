"""Predictions played from ground truth with dial-in errors: tests everything behind a backbone.

The scripted world is a ground plane under the whole drive and a dome around it: a convex room,
so every surface point inside the image is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calm_edge.backbones.base import BackboneError
from calm_edge.config import Config
from calm_edge.geometry import pinhole, se3
from calm_edge.types import Float, Float32, Hints, Int, Landmarks, Prediction
from device.frame import Eye

CAMERA_HEIGHT_M = 1.65
DEPTH_STRIDE = 8
LANDMARK_GRID = (6, 10)


@dataclass(frozen=True, slots=True)
class ScriptedErrors:
    """How wrong the predictions are.

    scale_log_sigma: of log raw units a world unit, a batch. focal_log_error: one an eye.
    rotation_sigma_rad, translation_sigma: of each pose; world units. depth_warp: amplitude of a
    smooth relative depth error. match_sigma_px: of every landmark observation.
    """

    scale_log_sigma: float = 0.0
    focal_log_error: tuple[float, float] = (0.0, 0.0)
    rotation_sigma_rad: float = 0.0
    translation_sigma: float = 0.0
    depth_warp: float = 0.0
    match_sigma_px: float = 0.0
    seed: int = 0


@dataclass(frozen=True, slots=True)
class ScriptedScene:
    """The truth: t_ns (N,) and T_w_p (N, 4, 4) of the primary, N >= 2; T_p_a (4, 4).

    K: (2, 3, 3) px an eye. size: (2, 2) width, height px an eye. Lengths: world units.
    """

    t_ns: Int
    T_w_p: Float
    T_p_a: Float
    K: Float
    size: Int

    def T_w_c(self, eyes: Int, t_ns: Int) -> Float:
        """(N, 4, 4) of views at any stamp within a frame gap of the drive; raises BackboneError."""
        gap = np.diff(self.t_ns[[0, 1, -2, -1]])[[0, 2]]
        if t_ns.min() < self.t_ns[0] - gap[0] or t_ns.max() > self.t_ns[-1] + gap[1]:
            raise BackboneError("scripted: a frame's stamp lies outside the scripted drive")
        start = self.t_ns[0]
        T_w_p = se3.interpolate_at(self.t_ns - start, self.T_w_p, (t_ns - start).astype(np.float64))
        return np.asarray(T_w_p @ np.stack([np.eye(4), self.T_p_a])[eyes])

    def depth(self, rays_w: Float, centre_w: Float) -> Float:
        """Multiples (...) of rays (..., 3) from centre_w (3,) to the first surface."""
        floor_y = self.T_w_p[:, 1, 3].max() + CAMERA_HEIGHT_M
        middle = (self.T_w_p[:, :3, 3].min(0) + self.T_w_p[:, :3, 3].max(0)) / 2
        radius = 30.0 + np.linalg.norm(self.T_w_p[:, :3, 3] - middle, axis=1).max()
        a, offset = (rays_w**2).sum(-1), centre_w - middle
        b = rays_w @ offset
        dome = (-b + np.sqrt(b * b + a * (radius**2 - offset @ offset))) / a
        down = rays_w[..., 1] > 1e-9
        floor = (floor_y - centre_w[1]) / np.where(down, rays_w[..., 1], 1.0)
        return np.asarray(np.where(down, np.minimum(floor, dome), dome))


class _Draw(NamedTuple):
    """The errors of one batch: scale, twists (N, 6), warp phases (N, 3) and the generator."""

    scale: float
    twists: Float
    phases: Float
    rng: np.random.Generator


class ScriptedBackbone:
    """The scene seen through the errors. Images are ignored; every draw is seeded by the stamps."""

    name = "scripted"

    def __init__(self, scene: ScriptedScene, errors: ScriptedErrors | None = None) -> None:
        self._scene = scene
        self._errors = errors or ScriptedErrors()

    @classmethod
    def from_config(cls, config: Config) -> ScriptedBackbone:
        """`scripted:FOLDER` with a sequence's poses0.txt, and its times0.txt, calib.txt if any.

        T_p_a.txt (12 numbers, a KITTI row) is the rig; else one unit to the right. Raises
        BackboneError.
        """
        folder = config.backbone.name.partition(":")[2]
        if not folder:
            raise BackboneError("backbone.name = 'scripted': name a folder, scripted:FOLDER")
        scene = _read_scene(Path(folder), config)
        return cls(scene, ScriptedErrors(seed=config.backbone.seed))

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Poses, K and landmarks, without depth."""
        scene, eyes, draw = self._scene, hints.eyes, self._draw(hints)
        T_w_c = scene.T_w_c(eyes, hints.t_ns)
        T_s_c = se3.inverse(T_w_c[0]) @ T_w_c @ se3.exp(draw.twists)
        T_s_c[:, :3, 3] *= draw.scale
        K = scene.K[eyes]
        K[:, :2, :2] *= np.exp(np.array(self._errors.focal_log_error))[eyes, None, None]
        landmarks = self._landmarks(T_w_c, eyes, draw)
        sigma = np.abs(np.array(self._errors.focal_log_error))[eyes] + 1e-3
        return Prediction(K=K, T_s_c=T_s_c, landmarks=landmarks, focal_log_sigma=sigma)

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """Adds depth at 1 / DEPTH_STRIDE of the image and full confidence."""
        if prediction.depth is not None:
            return prediction
        scene, draw = self._scene, self._draw(hints)
        width, height = scene.size.min(0) // DEPTH_STRIDE
        rows, columns = np.meshgrid(np.arange(height), np.arange(width), indexing="ij")
        pixels = np.stack([columns, rows], -1).astype(np.float64)
        u, v = columns / width, rows / height
        depth: list[Float32] = []
        T_w_c = scene.T_w_c(hints.eyes, hints.t_ns)
        for eye, T, (x, y, z) in zip(hints.eyes, T_w_c, draw.phases, strict=True):
            full = scene.size[eye]
            K = pinhole.resized(scene.K[eye], width / full[0], height / full[1])
            true = self._surface_depth(K, T, pixels)
            warp = np.sin(2 * np.pi * u + x) * np.cos(np.pi * v + y) * np.sin(z)
            depth.append((true * draw.scale * (1 + self._errors.depth_warp * warp)).astype("f4"))
        stack = np.stack(depth)
        return replace(prediction, depth=stack, confidence=np.ones_like(stack))

    def _draw(self, hints: Hints) -> _Draw:
        errors, n = self._errors, len(hints.t_ns)
        stamps = [int(t) % (1 << 64) for t in hints.t_ns]
        rng = np.random.default_rng([errors.seed, *stamps, *(int(e) for e in hints.eyes)])
        scale = float(np.exp(errors.scale_log_sigma * rng.standard_normal()))
        sigma = np.repeat([errors.translation_sigma, errors.rotation_sigma_rad], 3)
        return _Draw(
            scale, rng.standard_normal((n, 6)) * sigma, rng.uniform(0, 2 * np.pi, (n, 3)), rng
        )

    def _surface_depth(self, K: Float, T_w_c: Float, uv: Float) -> Float:
        """z-depths (...) of pixels (..., 2), world units."""
        rays = pinhole.back_project(K, uv, np.ones(uv.shape[:-1])) @ T_w_c[:3, :3].T
        return self._scene.depth(rays, T_w_c[:3, 3])

    def _landmarks(self, T_w_c: Float, eyes: Int, draw: _Draw) -> Landmarks:
        """A grid of surface points of each view, in every view that has them in its image."""
        scene, points = self._scene, []
        for eye, T in zip(eyes, T_w_c, strict=True):
            width, height = scene.size[eye]
            rows, columns = LANDMARK_GRID
            v, u = np.mgrid[0.5:rows, 0.5:columns]
            uv = np.stack([u * width / columns, v * height / rows], -1).reshape(-1, 2)
            p_c = pinhole.back_project(scene.K[eye], uv, self._surface_depth(scene.K[eye], T, uv))
            points.append(se3.transform(T, p_c))
        p_w = np.concatenate(points)
        index, view, pixels = [], [], []
        for n, (eye, T) in enumerate(zip(eyes, T_w_c, strict=True)):
            p_c = se3.transform(se3.inverse(T), p_w)
            uv = pinhole.project(scene.K[eye], p_c)
            inside = (p_c[:, 2] > 0.1) & (uv >= 0).all(1) & (uv <= scene.size[eye] - 1).all(1)
            (seen,) = np.nonzero(inside)
            index.append(seen)
            view.append(np.full(len(seen), n))
            pixels.append(uv[seen])
        uv = np.concatenate(pixels)
        uv += draw.rng.standard_normal(uv.shape) * self._errors.match_sigma_px
        return Landmarks(
            points_s=se3.transform(se3.inverse(T_w_c[0]), p_w) * draw.scale,
            index=np.concatenate(index),
            view=np.concatenate(view),
            uv=uv.astype(np.float32),
        )


def _rows(path: Path, columns: int) -> Float:
    try:
        rows = np.loadtxt(path, ndmin=2)
    except OSError as error:
        raise BackboneError(f"{path}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise BackboneError(f"{path}: not a table of numbers: {error}") from None
    if rows.shape[1] != columns:
        raise BackboneError(f"{path}: expected {columns} numbers a row, found {rows.shape[1]}")
    return np.asarray(rows, np.float64)


def _poses(path: Path) -> Float:
    rows = _rows(path, 12).reshape(-1, 3, 4)
    return se3.compose(rows[:, :, :3], rows[:, :, 3])


def _read_scene(folder: Path, config: Config) -> ScriptedScene:
    from calm_edge.frontend import sequence

    T_w_p = _poses(folder / "poses0.txt")
    times, calib, rig = (folder / name for name in ("times0.txt", "calib.txt", "T_p_a.txt"))
    if times.exists():
        t_ns = sequence.read_times(times)
    else:
        period_ns = 1e9 / sequence.DEFAULT_RATE_HZ
        t_ns = sequence.ORIGIN_NS + np.round(np.arange(len(T_w_p)) * period_ns).astype(np.int64)
    if len(t_ns) != len(T_w_p) or len(T_w_p) < 2:
        raise BackboneError(f"{folder}: {len(T_w_p)} poses and {len(t_ns)} times; need 2 or more")
    T_p_a = _poses(rig)[0] if rig.exists() else se3.exp(np.array([1.0, 0, 0, 0, 0, 0]))
    width, height = config.capture.width_px, config.capture.height_px
    if calib.exists():
        rows = _rows(calib, 6)[[0, -1]]
        K = np.stack([pinhole.matrix(*row[:4]) for row in rows])
        size = rows[:, 4:].astype(np.int64)
    else:
        K = np.stack([pinhole.from_hfov(73.0, width, height)] * len(Eye))
        size = np.array([[width, height]] * len(Eye))
    return ScriptedScene(t_ns=t_ns, T_w_p=T_w_p, T_p_a=T_p_a, K=K, size=size)
