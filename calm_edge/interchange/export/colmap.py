"""COLMAP's sparse model, text or binary, with pictures of both eyes, rig and landmarks.

Format: COLMAP 3.12 or later (rigs and frames); older versions and splat trainers read the same
cameras, images and points3D. COLMAP's pixel centres are at half pixels.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.interchange.calibration.colmap import CENTRE, model_of
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.colmap_files import (
    CameraRow,
    FrameRow,
    ImageRow,
    Model,
    PointRow,
    write_binary,
    write_text,
)
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.scene import IMAGES, Scene, read_scene, write_pictures
from calm_edge.interchange.export.tum import described
from calm_edge.types import Bytes, Float
from device.frame import Eye

MODEL = "sparse/0"
# exposures that differ by less are one frame of the rig
SAME_NS = 100_000


@dataclass(frozen=True, slots=True)
class RigFrame:
    """Pictures (indices) exposed at one time. T_r_w: (4, 4) world -> primary at that time."""

    T_r_w: Float
    pictures: tuple[int, ...]


class Colmap:
    """`images/` and `sparse/0/`."""

    name = "colmap"
    writes = "COLMAP's pictures, cameras, poses, rig and landmarks"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write pictures and model; raises InterchangeError."""
        scene = read_scene(drive, options)
        color = write_pictures(drive, scene, folder, options)
        model = folder / MODEL
        model.mkdir(parents=True)
        frames = rig_frames(drive, scene)
        rows = model_rows(scene, color, drive.keyframes.T_p_a, frames)
        (write_binary if options.binary else write_text)(model, rows)
        pictures = f"{IMAGES}: {len(scene.pictures)} of {len(scene.cameras)} cameras"
        error = scene.error_px.mean() if len(scene.error_px) else 0.0
        kinds = ", ".join(each.model for each in rows.cameras)
        points = f"{len(scene.points_w)} landmarks, mean reprojection error {error:.2f} px"
        return Written(
            (pictures, f"{MODEL}: cameras {kinds}; {len(frames)} frames of the rig; {points}"),
            (
                *described(drive),
                "one pose for each picture, at its middle row: rolling shutter is not modelled",
                *scene.assumed,
            ),
            scene.left_out,
        )


def rig_frames(drive: ExportedDrive, scene: Scene) -> list[RigFrame]:
    """Frames of the rig in order of exposure.

    Each picture is a frame of its own, unless both eyes were exposed at the same time.
    """
    stamps = np.array([each.t_ns for each in scene.pictures], np.int64)
    assistant = np.array([each.eye is Eye.ASSISTANT for each in scene.pictures])
    exposed = stamps.copy()
    if assistant.any():
        exposed[assistant] = drive.exposed_ns(stamps[assistant])
    T_a_p = drive.keyframes.T_p_a
    frames: list[RigFrame] = []
    last_ns = 0
    for i in np.argsort(exposed, kind="stable").tolist():
        each = scene.pictures[i]
        same = bool(frames) and exposed[i] - last_ns < SAME_NS
        if same and scene.pictures[frames[-1].pictures[0]].eye is not each.eye:
            frames[-1] = RigFrame(frames[-1].T_r_w, (*frames[-1].pictures, i))
            continue
        T_w_r = each.T_w_c @ se3.inverse(T_a_p) if assistant[i] else each.T_w_c
        frames.append(RigFrame(se3.inverse(T_w_r), (i,)))
        last_ns = int(exposed[i])
    return frames


def model_rows(scene: Scene, color: Bytes, T_p_a: Float, frames: list[RigFrame]) -> Model:
    """Contents of the model's files; ids are counted from 1. color: (P, 3) of the points."""
    cameras = tuple(
        CameraRow(eye + 1, *model_of(camera), camera.width, camera.height)
        for eye, camera in scene.cameras.items()
    )
    order = np.argsort(scene.picture, kind="stable")
    starts = np.searchsorted(scene.picture[order], np.arange(len(scene.pictures) + 1))
    # place of each observation among those of its picture
    place = np.empty(len(order), np.int64)
    place[order] = np.arange(len(order)) - starts[scene.picture[order]]
    images = []
    for i, each in enumerate(scene.pictures):
        rows = order[starts[i] : starts[i + 1]]
        uv = (scene.uv[rows] + CENTRE).tolist()
        ids = (scene.point[rows] + 1).tolist()
        points = tuple((x, y, number) for (x, y), number in zip(uv, ids, strict=True))
        pose = pose_row(se3.inverse(each.T_w_c))
        images.append(ImageRow(i + 1, pose, each.eye + 1, each.name, points))
    by_point = np.argsort(scene.point, kind="stable")
    ends = np.searchsorted(scene.point[by_point], np.arange(len(scene.points_w) + 1))
    points_3d = []
    for k, (p, rgb) in enumerate(zip(scene.points_w.tolist(), color.tolist(), strict=True)):
        rows = by_point[ends[k] : ends[k + 1]]
        track = zip((scene.picture[rows] + 1).tolist(), place[rows].tolist(), strict=True)
        points_3d.append(PointRow(k + 1, p, rgb, float(scene.error_px[k]), tuple(track)))
    return Model(
        cameras,
        pose_row(se3.inverse(T_p_a)) if len(cameras) == 2 else None,
        tuple(
            FrameRow(
                n,
                pose_row(frame.T_r_w),
                tuple((scene.pictures[i].eye + 1, i + 1) for i in frame.pictures),
            )
            for n, frame in enumerate(frames, 1)
        ),
        tuple(images),
        tuple(points_3d),
    )


def pose_row(T: Float) -> tuple[float, ...]:
    """Quaternion w, x, y, z and translation of T (4, 4)."""
    x, y, z, w = se3.quaternions(T[None, :3, :3])[0].tolist()
    return (w, x, y, z, *T[:3, 3].tolist())
