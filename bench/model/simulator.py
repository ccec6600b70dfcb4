"""Exact depth of rendered drives, by rendering again from their poses.

`drive_sim.py` writes pictures and poses but no depth. Its options and seed, stored in `rig.json`,
suffice to rebuild the world and the pose of the first picture.
"""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from bench.drives import SIMULATOR
from calm_edge.evaluation import EvaluationError
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.trajectories import read_kitti
from calm_edge.types import Float, Float32
from device.frame import Eye

CACHE = "depth"
# Distance between the samples of the path in the simulator.
STEP_M = 0.5
# A path whose ends are nearer than this is a circuit.
CLOSED_M = 150.0
SAME_M = 1e-3


def true_cameras(folder: Path) -> tuple[Camera, ...]:
    """Cameras of a rendered drive, one per eye, with pixel centres at integer coordinates.

    The simulator's principal point is relative to the picture's corner, half a pixel before the
    centre of the first pixel.
    """
    rows = np.loadtxt(folder / "calib.txt", ndmin=2)
    return tuple(
        Perspective(fx, fy, cx - 0.5, cy - 0.5, int(width), int(height))
        for fx, fy, cx, cy, width, height in rows.tolist()
    )


class DriveWorld:
    """World of one rendered drive, with a renderer that is created at first use.

    Depth is cached in `depth/` in the folder of the drive.
    """

    def __init__(self, folder: Path, simulator: Path = SIMULATOR) -> None:
        self.folder = folder
        self.T_w_c = tuple(read_kitti(folder / f"poses{int(eye)}.txt") for eye in Eye)
        self._simulator = simulator
        self._made: tuple[Any, Float, SimpleNamespace] | None = None

    def z_depth(self, eye: int, frame: int) -> Float32:
        """Z-depth (H, W) m at the pixel centres, 0 for sky; raises EvaluationError."""
        kept = self.folder / CACHE / f"cam{eye}" / f"{frame:06d}.npy"
        if kept.is_file():
            return np.asarray(np.load(kept), np.float32)
        z = self._render(eye, frame)
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part.npy")
        np.save(part, z)
        part.rename(kept)
        return z

    def _render(self, eye: int, frame: int) -> Float32:
        if self._made is None:
            self._made = self._build()
        renderer, T_mesh_w, rig = self._made
        f = float(rig.fx[eye])
        T = T_mesh_w @ self.T_w_c[eye][frame]
        _, along = renderer(T, f, f, rig.width / 2, rig.height / 2, 0.0)
        v, u = np.mgrid[: rig.height, : rig.width]
        ray = np.hypot(np.hypot(u - (rig.width - 1) / 2, v - (rig.height - 1) / 2), f) / f
        return np.asarray(along / ray, np.float32)

    def _build(self) -> tuple[Any, Float, SimpleNamespace]:
        rig = _rig(self.folder)
        tool = _module(self._simulator)
        try:
            root = Path(tool.find_torcs(rig.torcs))
            mesh = next(root.glob(f"tracks/*/{rig.track}/{rig.track}.acc"))
            triangles, road = tool.triangles(tool.load_acc(mesh))
            textures = [str(mesh.parent), *(str(root / "data" / d) for d in ("textures", "img"))]
            # one sample per pixel, at its centre
            renderer = tool.Renderer(triangles, textures, rig.width, rig.height, 1)
        except Exception as error:  # a graphics driver may raise anything
            raise EvaluationError(f"{self.folder}: depth cannot be rendered ({error})") from None
        path = tool.centreline(road)
        if rig.laps > 1 and np.linalg.norm(path[0] - path[-1]) < CLOSED_M:
            path = np.concatenate([path] * int(np.ceil(rig.laps)))
        path = tool.resample(path, STEP_M)[int(rig.skip_s / STEP_M) :]
        rng = np.random.default_rng(rig.seed)
        times, pose = tool.drive(path, STEP_M, rng, rig.frames, rig.hz, rig.vmax, rig.bumps)
        T_mesh_c = pose(times + rng.normal(0, rig.jitter_ms / 1e3, len(times)))
        T_mesh_w = T_mesh_c[0]
        apart = (T_mesh_w @ self.T_w_c[0])[:, :3, 3] - T_mesh_c[:, :3, 3]
        if np.abs(apart).max() > SAME_M:
            raise EvaluationError(
                f"{self.folder}: made by another version of {self._simulator.name}; remove it"
            )
        return renderer, np.asarray(T_mesh_w, np.float64), rig


def _rig(folder: Path) -> SimpleNamespace:
    try:
        return SimpleNamespace(**json.loads((folder / "rig.json").read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise EvaluationError(
            f"{folder / 'rig.json'}: not the simulator's options ({error})"
        ) from None


def _module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise EvaluationError(f"{path}: missing; it is needed for the depth of rendered drives")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except ImportError as error:
        raise EvaluationError(
            f"{path}: {error}; it is needed for the depth of rendered drives"
        ) from None
    return module
