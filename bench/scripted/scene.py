"""Ground truth of a scripted drive: trajectory, rig, cameras and world."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.scripted.street import CAMERA_HEIGHT_M, Street
from calm_edge.backbones.base import BackboneError
from calm_edge.config import Config
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.types import Float, Hints, Int
from device.frame import Eye


@dataclass(frozen=True, slots=True)
class Exposures:
    """True exposure times t_ns (N,) of frames, and their stamps stamp_ns (N,), increasing."""

    stamp_ns: Int
    t_ns: Int

    def at(self, stamp_ns: Int) -> Int:
        """True exposure times (M,) of stamps (M,); raises BackboneError for an unknown stamp."""
        place = np.clip(np.searchsorted(self.stamp_ns, stamp_ns), 0, len(self.stamp_ns) - 1)
        if np.any(self.stamp_ns[place] != stamp_ns):
            raise BackboneError("scripted: a stamp is not that of any frame of the drive")
        return self.t_ns[place]


@dataclass(frozen=True, slots=True)
class ScriptedScene:
    """Ground truth of a scripted drive; lengths in world units.

    t_ns: (N,), N >= 2. T_w_p: (N, 4, 4) of the primary. T_p_a: (4, 4). cameras: one per eye.
    street: the world, or None for a convex room: a ground plane under the whole drive and a dome
    around it, in which nothing is occluded. exposures: of each eye, None if the stamps are true.
    """

    t_ns: Int
    T_w_p: Float
    T_p_a: Float
    cameras: tuple[Camera, Camera]
    street: Street | None = None
    exposures: tuple[Exposures, Exposures] | None = None

    @property
    def size(self) -> Int:
        """Width and height [px] of the pictures of each eye, (2, 2)."""
        return np.array([(camera.width, camera.height) for camera in self.cameras])

    def true_ns(self, hints: Hints) -> Int:
        """True exposure times (N,) of the views of a batch; raises BackboneError."""
        if self.exposures is None:
            return hints.t_ns
        t_ns = np.empty_like(hints.t_ns)
        for eye in Eye:
            of_eye = hints.eyes == eye
            t_ns[of_eye] = self.exposures[eye].at(hints.t_ns[of_eye])
        return t_ns

    def T_w_c(self, eyes: Int, t_ns: Int) -> Float:
        """Interpolate the poses (N, 4, 4) of views at t_ns (N,).

        Up to one frame before and after the drive they are extrapolated; beyond, BackboneError is
        raised.
        """
        gap = np.diff(self.t_ns[[0, 1, -2, -1]])[[0, 2]]
        if t_ns.min() < self.t_ns[0] - gap[0] or t_ns.max() > self.t_ns[-1] + gap[1]:
            raise BackboneError("scripted: a frame's stamp lies outside the time of poses0.txt")
        start = self.t_ns[0]
        T_w_p = se3.interpolate_at(self.t_ns - start, self.T_w_p, (t_ns - start).astype(np.float64))
        return np.asarray(T_w_p @ np.stack([np.eye(4), self.T_p_a])[eyes])

    def depth(self, rays_w: Float, centre_w: Float) -> Float:
        """Depth (...) along rays (..., 3) from centres (..., 3), as a multiple of the ray's length.

        inf where there is only sky.
        """
        if self.street is not None:
            return self.street.depth(rays_w, centre_w)
        return self._room(rays_w, centre_w)

    def surface(self, cameras: Sequence[Camera], T_w_c: Float, uv: Float) -> tuple[Float, Float]:
        """Find the surface points at pixels (N, P, 2) of N views T_w_c (N, 4, 4).

        Returns their z-depths (N, P), inf where there is no surface, and positions (N, P, 3), world
        units.
        """
        rays_c = rays(cameras, uv)
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


def rays(cameras: Sequence[Camera], uv: Float) -> Float:
    """Back-project pixels (N, ..., 2) of N views to rays (N, ..., 3) with z = 1."""
    ones = np.ones(uv.shape[1:-1])
    return np.stack([c.back_project(at, ones) for c, at in zip(cameras, uv, strict=True)])


def read_rows(path: Path, columns: int) -> Float:
    """Read a text table of numbers (N, columns); raises BackboneError."""
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
    """Read poses (N, 4, 4) from rows of a KITTI trajectory; raises BackboneError."""
    rows = read_rows(path, 12).reshape(-1, 3, 4)
    return se3.compose(rows[:, :, :3], rows[:, :, 3])


def read_cameras(path: Path) -> tuple[Camera, Camera]:
    """Read the camera of each eye from a sequence folder's calib.txt; raises BackboneError."""
    rows = read_rows(path, 6).tolist()
    primary, assistant = (Perspective(*row[:4], *map(int, row[4:])) for row in (rows[0], rows[-1]))
    return primary, assistant


def read_scene(folder: Path, config: Config) -> ScriptedScene:
    """Read the ground truth of a sequence folder, in a convex room; raises BackboneError."""
    from calm_edge.recording import picture_folder, sequence_folder

    T_w_p = read_poses(folder / "poses0.txt")
    times, calib, rig = (folder / name for name in ("times0.txt", "calib.txt", "T_p_a.txt"))
    if times.exists():
        t_ns = sequence_folder.read_times(times)
    else:
        period_ns = 1e9 / picture_folder.DEFAULT_RATE_HZ
        t_ns = sequence_folder.ORIGIN_NS + np.round(np.arange(len(T_w_p)) * period_ns).astype(
            np.int64
        )
    if len(t_ns) != len(T_w_p) or len(T_w_p) < 2:
        raise BackboneError(f"{folder}: {len(T_w_p)} poses and {len(t_ns)} times; need 2 or more")
    T_p_a = read_poses(rig)[0] if rig.exists() else se3.exp(np.array([1.0, 0, 0, 0, 0, 0]))
    default = Perspective.from_hfov(73.0, config.capture.width_px, config.capture.height_px)
    cameras = read_cameras(calib) if calib.exists() else (default, default)
    return ScriptedScene(t_ns=t_ns, T_w_p=T_w_p, T_p_a=T_p_a, cameras=cameras)
