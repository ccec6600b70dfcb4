"""Scripted drives along known trajectories, with the windows that a front end would form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.drives import DATA
from bench.kilometres.lenses import LENSES
from bench.kilometres.streams import Streams
from bench.scripted import ScriptedScene, Street
from bench.scripted.scene import read_cameras, read_poses
from calm_edge.config import Config
from calm_edge.frontend.association import WindowBuilder
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.polyline import path_length
from calm_edge.recording import picture_folder, sequence_folder
from calm_edge.types import Bytes, CalmEdgeError, Float, Int, Keyframe, SubmapWindow
from device.frame import Eye, Frame

TRAJECTORIES = DATA / "trajectories"
SEQUENCES = tuple(f"{k:02d}" for k in range(11))
# Left camera of KITTI odometry; the principal point is moved to the centre.
KITTI_FOCAL_PX, KITTI_SIZE = 718.856, (1241, 376)
KITTI_SPACING_M = 0.54
# Motion between keyframes: the selector's threshold of 25 px is 2 degrees at a focal of 718 px, and
# on a street about 1.2 m.
STEP_M, STEP_RAD = 1.2, np.radians(2.0)
# After max_keyframe_gap_s without a keyframe this share of STEP_M makes one, as in the front end's
# keyframe selector (its MOVING_SHARE).
_MOVING_SHARE = 0.2


class DriveError(CalmEdgeError):
    """A drive is missing or cannot be read."""


@dataclass(frozen=True, slots=True)
class Drive:
    """A scripted drive and its windows.

    T_w_p: (N, 4, 4) m, the true poses of the primary keyframes 0 ... N - 1.
    """

    name: str
    scene: ScriptedScene
    keyframes: tuple[Keyframe, ...]
    T_w_p: Float
    windows: tuple[SubmapWindow, ...]

    @property
    def path_m(self) -> float:
        """Length of the true path through the keyframes."""
        return path_length(self.T_w_p[:, :3, 3])


def kitti(
    name: str,
    config: Config,
    seed: int = 0,
    streams: Streams | None = None,
    frames: int = 0,
    lens: str = "",
) -> Drive:
    """Scripted drive along the poses of KITTI odometry `00` ... `10`.

    The rig and the assistant's field of view are drawn by the seed. frames: number of first poses
    to use, 0 for all. lens: of `lenses.LENSES`, empty for pinhole cameras. Raises DriveError if the
    poses are missing.
    """
    path = TRAJECTORIES / f"kitti_odom_{name}.txt"
    if not path.is_file():
        raise DriveError(f"{path}: missing; put the poses of KITTI odometry there")
    T_w_p = _rigid(read_poses(path))
    times = path.with_name(f"{path.stem}_times.txt")
    if times.is_file():
        t_ns = sequence_folder.read_times(times)[: len(T_w_p)]
    else:
        period_ns = 1e9 / picture_folder.DEFAULT_RATE_HZ
        t_ns = sequence_folder.ORIGIN_NS + np.round(np.arange(len(T_w_p)) * period_ns).astype(
            np.int64
        )
    T_w_p, t_ns = T_w_p[: frames or None], t_ns[: frames or None]
    rng = np.random.default_rng([seed, *name.encode()])
    width, height = KITTI_SIZE
    primary = Perspective(
        KITTI_FOCAL_PX, KITTI_FOCAL_PX, (width - 1) / 2, (height - 1) / 2, width, height
    )
    assistant = Perspective.from_hfov(rng.uniform(70.0, 95.0), 1280, 400)
    behind: Callable[[Perspective], Camera] = LENSES[lens] if lens else lambda camera: camera
    scene = ScriptedScene(
        t_ns=t_ns,
        T_w_p=T_w_p,
        T_p_a=rig(rng, KITTI_SPACING_M),
        cameras=(behind(primary), behind(assistant)),
        street=Street.along(T_w_p),
    )
    return cut(f"kitti_{name}", scene, config, streams or Streams(), seed)


def rendered(folder: Path, config: Config, seed: int = 0, streams: Streams | None = None) -> Drive:
    """Scripted drive with path, rig and cameras of a rendered drive's folder; raises DriveError."""
    if not (folder / "poses1.txt").is_file():
        raise DriveError(f"{folder}: no poses1.txt; render the drive with drive_sim.py first")
    T_w_p, T_w_a = read_poses(folder / "poses0.txt"), read_poses(folder / "poses1.txt")
    # the street needs a world with y down, like the first camera's frame
    T_w_p, T_w_a = se3.inverse(T_w_p[0]) @ T_w_p, se3.inverse(T_w_p[0]) @ T_w_a
    t_ns, t_a = (sequence_folder.read_times(folder / f"times{eye}.txt") for eye in (0, 1))
    T_w_ref = se3.interpolate_at(t_ns - t_ns[0], T_w_p, (t_a - t_ns[0]).astype(np.float64))
    scene = ScriptedScene(
        t_ns=t_ns,
        T_w_p=T_w_p,
        T_p_a=se3.mean(se3.inverse(T_w_ref) @ T_w_a),
        cameras=read_cameras(folder / "calib.txt"),
        street=Street.along(T_w_p),
    )
    return cut(folder.name, scene, config, streams or Streams(), seed)


def rig(rng: np.random.Generator, spacing_m: float) -> Float:
    """Draw T_p_a (4, 4): to the right by the spacing, with mounting errors of a few degrees."""
    side = np.array([1.0, *(0.05 * rng.standard_normal(2))])
    turn = np.radians(1.5) * rng.standard_normal(3)
    return se3.compose(se3.so3_exp(turn), spacing_m * side / np.linalg.norm(side))


def cut(name: str, scene: ScriptedScene, config: Config, streams: Streams, seed: int) -> Drive:
    """Form the keyframes and windows of a scene as the front end does (paper IV-A)."""
    exposures = streams.exposures(scene.t_ns, seed)
    scene = replace(scene, exposures=exposures)
    of_primary = exposures[Eye.PRIMARY]
    T_w_p = scene.T_w_c(np.zeros(len(of_primary.t_ns), np.int64), of_primary.t_ns)
    chosen = _keyframes(of_primary.t_ns, T_w_p, config.frontend.max_keyframe_gap_s)
    builder = WindowBuilder(config.frontend)
    windows: list[SubmapWindow] = []
    keyframes: list[Keyframe] = []
    is_keyframe = set(chosen.tolist())
    for stamp, eye, k in _arrivals(exposures[0].stamp_ns, exposures[1].stamp_ns):
        frame = Frame(Eye(eye), k, stamp, blank(scene.size[eye]))
        if eye == Eye.ASSISTANT:
            windows += builder.add_assistant(frame)
        elif k in is_keyframe:
            keyframes.append(Keyframe(len(keyframes), frame))
            windows += builder.add_keyframe(keyframes[-1])
        else:
            windows += builder.advance(stamp)
    windows += builder.flush()
    return Drive(name, scene, tuple(keyframes), T_w_p[chosen], tuple(windows))


def blank(size: Int) -> Bytes:
    """Black picture of size (2,) (width, height): a broadcast array of one byte."""
    return np.broadcast_to(np.zeros((), np.uint8), (int(size[1]), int(size[0]), 3))


def _arrivals(primary: Int, assistant: Int) -> list[tuple[int, int, int]]:
    """Frames of both streams as (stamp, eye, index), in order of stamps."""
    stamps = [(int(t), 0, k) for k, t in enumerate(primary)]
    return sorted(stamps + [(int(t), 1, k) for k, t in enumerate(assistant)])


def _keyframes(t_ns: Int, T_w_p: Float, max_gap_s: float) -> Int:
    """Indices of the poses (N, 4, 4) that become keyframes; the first always does.

    t_ns: (N,) of the poses. max_gap_s: time since the last keyframe after which the share
    _MOVING_SHARE of the usual motion makes one.
    """
    chosen = [0]
    for k in range(1, len(t_ns)):
        step = se3.inverse(T_w_p[chosen[-1]]) @ T_w_p[k]
        turn = float(np.linalg.norm(se3.so3_log(step[:3, :3]))) / STEP_RAD
        moved = float(np.linalg.norm(step[:3, 3])) / STEP_M
        overdue = t_ns[k] - t_ns[chosen[-1]] > max_gap_s * 1e9
        # a rotation without translation makes no keyframe
        if moved > _MOVING_SHARE and (moved + turn > 1 or overdue):
            chosen.append(k)
    return np.array(chosen)


def _rigid(T: Float) -> Float:
    """Orthonormalise the rotations of poses (N, 4, 4), which a text file has rounded."""
    U, _, Vt = np.linalg.svd(T[:, :3, :3])
    return se3.compose(U @ Vt, T[:, :3, 3])
