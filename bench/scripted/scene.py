"""The truth that scripted predictions are played from: a drive, its rig, its cameras, its world."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.scripted.street import CAMERA_HEIGHT_M, Street
from calm_edge.backbones.base import BackboneError
from calm_edge.config import Config
from calm_edge.geometry import pinhole, se3
from calm_edge.types import Float, Hints, Int
from device.frame import Eye


@dataclass(frozen=True, slots=True)
class Exposures:
    """When frames were truly exposed: t_ns (N,) of frames stamped stamp_ns (N,), growing."""

    stamp_ns: Int
    t_ns: Int

    def at(self, stamp_ns: Int) -> Int:
        """(M,) true times of stamps (M,); raises BackboneError for one that no frame has."""
        place = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 0, len(self.stamp_ns) - 1)
        if np.any(self.stamp_ns[place] != stamp_ns):
            raise BackboneError("scripted: no frame of the scripted drive has this stamp")
        return self.t_ns[place]


@dataclass(frozen=True, slots=True)
class ScriptedScene:
    """The truth: t_ns (N,) and T_w_p (N, 4, 4) of the primary, N >= 2; T_p_a (4, 4).

    K: (2, 3, 3) px an eye. size: (2, 2) width, height px an eye. Lengths: world units. street: the
    world; None is a convex room, a ground plane under the whole drive and a dome around it, where
    every surface point inside the image is seen. exposures: of each eye, where stamps are not true.
    """

    t_ns: Int
    T_w_p: Float
    T_p_a: Float
    K: Float
    size: Int
    street: Street | None = None
    exposures: tuple[Exposures, Exposures] | None = None

    def true_ns(self, hints: Hints) -> Int:
        """(N,) when the views of a batch were exposed; raises BackboneError."""
        if self.exposures is None:
            return hints.t_ns
        t_ns = np.empty_like(hints.t_ns)
        for eye in Eye:
            of_eye = hints.eyes == eye
            t_ns[of_eye] = self.exposures[eye].at(hints.t_ns[of_eye])
        return t_ns

    def T_w_c(self, eyes: Int, t_ns: Int) -> Float:
        """(N, 4, 4) of views at any time within a frame gap of the drive; raises BackboneError."""
        gap = np.diff(self.t_ns[[0, 1, -2, -1]])[[0, 2]]
        if t_ns.min() < self.t_ns[0] - gap[0] or t_ns.max() > self.t_ns[-1] + gap[1]:
            raise BackboneError("scripted: a frame's stamp lies outside the scripted drive")
        start = self.t_ns[0]
        T_w_p = se3.interpolate_at(self.t_ns - start, self.T_w_p, (t_ns - start).astype(np.float64))
        return np.asarray(T_w_p @ np.stack([np.eye(4), self.T_p_a])[eyes])

    def depth(self, rays_w: Float, centre_w: Float) -> Float:
        """Multiples (...) of rays (..., 3) from centres (..., 3) to a surface, inf for none."""
        if self.street is not None:
            return self.street.depth(rays_w, centre_w)
        return self._room(rays_w, centre_w)

    def surface(self, K: Float, T_w_c: Float, uv: Float) -> tuple[Float, Float]:
        """z-depths (N, P) of pixels (N, P, 2) of N views and their points (N, P, 3), world units.

        inf where there is no surface. K: (N, 3, 3). T_w_c: (N, 4, 4).
        """
        rays_c = pinhole.back_project(K[:, None], uv, np.ones(uv.shape[:-1]))
        rays_w = rays_c @ np.swapaxes(T_w_c[:, :3, :3], 1, 2)
        centre = T_w_c[:, None, :3, 3]
        z = self.depth(rays_w, centre)
        return z, centre + rays_w * z[..., None]

    def _room(self, rays_w: Float, centre_w: Float) -> Float:
        floor_y = self.T_w_p[:, 1, 3].max() + CAMERA_HEIGHT_M
        middle = (self.T_w_p[:, :3, 3].min(0) + self.T_w_p[:, :3, 3].max(0)) / 2
        radius = 30.0 + np.linalg.norm(self.T_w_p[:, :3, 3] - middle, axis=1).max()
        a, offset = (rays_w**2).sum(-1), centre_w - middle
        b = (rays_w * offset).sum(-1)
        dome = (-b + np.sqrt(b * b + a * (radius**2 - (offset**2).sum(-1)))) / a
        down = rays_w[..., 1] > 1e-9
        floor = (floor_y - centre_w[..., 1]) / np.where(down, rays_w[..., 1], 1.0)
        return np.asarray(np.where(down, np.minimum(floor, dome), dome))


def read_rows(path: Path, columns: int) -> Float:
    """(N, columns) of a text table; raises BackboneError."""
    try:
        rows = np.loadtxt(path, ndmin=2)
    except OSError as error:
        raise BackboneError(f"{path}: cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise BackboneError(f"{path}: not a table of numbers: {error}") from None
    if rows.shape[1] != columns:
        raise BackboneError(f"{path}: expected {columns} numbers a row, found {rows.shape[1]}")
    return np.asarray(rows, np.float64)


def read_poses(path: Path) -> Float:
    """(N, 4, 4) of KITTI rows; raises BackboneError."""
    rows = read_rows(path, 12).reshape(-1, 3, 4)
    return se3.compose(rows[:, :, :3], rows[:, :, 3])


def read_scene(folder: Path, config: Config) -> ScriptedScene:
    """A sequence folder's truth in a convex room; raises BackboneError."""
    from calm_edge.recording import sequence_folder

    T_w_p = read_poses(folder / "poses0.txt")
    times, calib, rig = (folder / name for name in ("times0.txt", "calib.txt", "T_p_a.txt"))
    if times.exists():
        t_ns = sequence_folder.read_times(times)
    else:
        period_ns = 1e9 / sequence_folder.DEFAULT_RATE_HZ
        t_ns = sequence_folder.ORIGIN_NS + np.round(np.arange(len(T_w_p)) * period_ns).astype(
            np.int64
        )
    if len(t_ns) != len(T_w_p) or len(T_w_p) < 2:
        raise BackboneError(f"{folder}: {len(T_w_p)} poses and {len(t_ns)} times; need 2 or more")
    T_p_a = read_poses(rig)[0] if rig.exists() else se3.exp(np.array([1.0, 0, 0, 0, 0, 0]))
    width, height = config.capture.width_px, config.capture.height_px
    if calib.exists():
        rows = read_rows(calib, 6)[[0, -1]]
        K = np.stack([pinhole.matrix(*row[:4]) for row in rows])
        size = rows[:, 4:].astype(np.int64)
    else:
        K = np.stack([pinhole.from_hfov(73.0, width, height)] * len(Eye))
        size = np.array([[width, height]] * len(Eye))
    return ScriptedScene(t_ns=t_ns, T_w_p=T_w_p, T_p_a=T_p_a, K=K, size=size)
