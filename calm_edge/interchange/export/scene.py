"""Pictures with their poses, cameras and landmarks, for reconstruction programs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.triangulation import triangulate
from calm_edge.geometry.undistortion import Undistortion, undistortion
from calm_edge.interchange.export.base import ExportOptions
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.placed_pictures import Picture, placed_pictures
from calm_edge.kit import estimated
from calm_edge.types import Bytes, Float, Int, LocalizerUpdate
from device.frame import Eye, Frame, jpeg

IMAGES = "images"
# A landmark with a larger mean reprojection error is left out, as is one that is further away than
# this many spacings: its distance is unknown.
MAX_ERROR_PX, MAX_SPACINGS = 4.0, 2000.0


@dataclass(frozen=True, slots=True)
class Scene:
    """Pictures and landmarks in the world.

    lenses: cameras as learned. cameras: of the pictures as exported, undistorted or not.
    points_w: (P, 3). error_px: (P,) mean reprojection error. Observations: point (O,), picture
    (O,), uv (O, 2) px in the exported pictures. assumed, left_out: lines for the user.
    """

    lenses: dict[Eye, Camera]
    cameras: dict[Eye, Camera]
    pictures: tuple[Picture, ...]
    points_w: Float
    error_px: Float
    point: Int
    picture: Int
    uv: Float
    assumed: tuple[str, ...]
    left_out: tuple[str, ...]


def read_scene(drive: ExportedDrive, options: ExportOptions) -> Scene:
    """Place the pictures of both eyes, and triangulate the landmarks from their poses.

    Landmarks are seen in keyframes alone. Raises InterchangeError if no frame has a pose.
    """
    assumed: list[str] = []
    left_out: list[str] = []
    learned = lenses(drive.last, assumed)
    maps = {eye: undistortion(lens) for eye, lens in learned.items()}
    cameras: dict[Eye, Camera] = dict(learned)
    if not options.distorted:
        cameras = {eye: found.camera for eye, found in maps.items()}
        left_out += [
            f"{100 * maps[eye].cut:.1f} % of the {eye.name.lower()}'s picture: outside of the "
            "undistorted one"
            for eye in cameras
            if maps[eye].cut > 1e-3
        ]
    pictures = placed_pictures(drive, set(learned), options, assumed, left_out)
    index = {(each.eye, each.t_ns): i for i, each in enumerate(pictures)}
    poses = np.array([each.T_w_c for each in pictures])
    parts: list[tuple[Float, Int, Int, Float]] = []
    offset = seen = 0
    missing: set[int] = set()
    done: set[int] = set()
    for update in drive.solved.updates():
        # updates at the end of a drive repeat sub-maps, without their landmarks
        number = update.submap.id
        if number in done or update.prediction.landmarks is None:
            missing.add(number)
            continue
        done.add(number)
        seen += len(update.prediction.landmarks.points_s)
        part = _landmarks(update, index, poses, learned, drive.spacing)
        parts.append((part[0], part[1] + offset, part[2], part[3]))
        offset += len(part[0])
    points = np.concatenate([part[0] for part in parts]) if parts else np.zeros((0, 3))
    point, picture = (
        np.concatenate([part[k] for part in parts]) if parts else np.zeros(0, np.int64)
        for k in (1, 2)
    )
    uv = np.concatenate([part[3] for part in parts]) if parts else np.zeros((0, 2))
    eyes = np.array([each.eye for each in pictures], np.int64)
    if not options.distorted:
        for eye, lens in learned.items():
            own = eyes[picture] == eye
            uv[own] = cameras[eye].project(lens.back_project(uv[own], np.ones(own.sum())))
    scene = Scene(
        learned, cameras, pictures, points, np.zeros(len(points)), point, picture, uv, (), ()
    )
    kept = _consistent(scene, poses, eyes)
    if missing - done:
        left_out.append(f"landmarks of {len(missing - done)} windows: not in {drive.solved.path}")
    if seen > len(kept.points_w):
        left_out.append(
            f"{seen - len(kept.points_w)} of {seen} landmarks: too far away, or more than "
            f"{MAX_ERROR_PX:g} px from where they were seen"
        )
    return replace(kept, assumed=tuple(assumed), left_out=tuple(left_out))


def write_pictures(
    drive: ExportedDrive, scene: Scene, folder: Path, options: ExportOptions
) -> Bytes:
    """Write all pictures to the folder IMAGES; return the colours (P, 3) RGB of the points.

    A picture that needs no undistortion is written as it was recorded.
    """
    color = np.zeros((len(scene.points_w), 3), np.uint8)
    first = np.full(len(scene.points_w), -1, np.int64)
    first[scene.point[::-1]] = np.arange(len(scene.point))[::-1]
    wanted = {(each.eye, each.t_ns): i for i, each in enumerate(scene.pictures)}
    for eye, lens in scene.lenses.items():
        (folder / IMAGES / eye.name.lower()).mkdir(parents=True)
        warp = undistortion(lens) if scene.cameras[eye] != lens else None
        for frame in drive.recording.frames(eye):
            number = wanted.get((eye, frame.t_ns))
            if number is None:
                continue
            shown = _write(folder / IMAGES / scene.pictures[number].name, frame, warp, options)
            rows = first[(first >= 0) & (scene.picture[first] == number)]
            at = np.rint(scene.uv[rows]).astype(np.int64)
            color[scene.point[rows]] = shown[at[:, 1], at[:, 0], ::-1]
    return color


def _write(path: Path, frame: Frame, warp: Undistortion | None, options: ExportOptions) -> Bytes:
    """Write a picture; return it as BGR (h, w, 3)."""
    bgr = frame.bgr()
    if warp is None:
        assert isinstance(frame.image, bytes)
        path.write_bytes(frame.image)
        return bgr
    shown: Bytes = np.asarray(cv2.remap(bgr, warp.map_x, warp.map_y, cv2.INTER_CUBIC), np.uint8)
    path.write_bytes(jpeg(shown, options.quality))
    return shown


def lenses(last: LocalizerUpdate, assumed: list[str]) -> dict[Eye, Camera]:
    """Cameras at the end of the drive."""
    submap, observed = last.submap, estimated.cameras(last)
    views = {Eye.PRIMARY: 0}
    if submap.assistant_ids:
        views[Eye.ASSISTANT] = submap.n_primary
    lenses = {eye: observed.get(eye, submap.cameras[view].standard) for eye, view in views.items()}
    for eye, lens in lenses.items():
        sigma = 100 * float(submap.focal_log_sigma[eye])
        doubt = "" if eye in observed else ", not observed in this drive: a guess"
        assumed.append(
            f"focal length of the {eye.name.lower()} {lens.fx:.1f} px as at the end of the drive "
            f"(sigma {sigma:.1f} %{doubt})"
        )
    return lenses


def _landmarks(
    update: LocalizerUpdate,
    index: dict[tuple[Eye, int], int],
    poses: Float,
    lenses: dict[Eye, Camera],
    spacing: float,
) -> tuple[Float, Int, Int, Float]:
    """Points (M, 3), and point, picture and pixel of each observation, of one window.

    Triangulated from the final poses. Points that are seen once, behind a camera or too far away
    are left out.
    """
    submap, marks = update.submap, update.prediction.landmarks
    assert marks is not None
    end = submap.n_primary + len(submap.assistant_ids)
    views = np.arange(len(submap.t_ns))
    eyes = np.where((views >= submap.n_primary) & (views < end), Eye.ASSISTANT, Eye.PRIMARY)
    keys = zip(eyes.tolist(), submap.t_ns.tolist(), strict=True)
    number = np.array([index.get((Eye(eye), t), -1) for eye, t in keys], np.int64)
    rows = np.flatnonzero(number[marks.view] >= 0)
    point, picture = marks.index[rows], number[marks.view[rows]]
    uv = marks.uv[rows].astype(np.float64)
    rays = np.full((len(rows), 2), np.nan)
    for eye, lens in lenses.items():
        own = eyes[marks.view[rows]] == eye
        rays[own] = lens.normalized(uv[own])
    good = np.isfinite(rays).all(1)
    point, picture, uv, rays = point[good], picture[good], uv[good], rays[good]
    n = len(marks.points_s)
    if not len(point):
        return np.zeros((0, 3)), point, picture, uv
    # near the origin, where the linear equations are well conditioned
    origin = poses[picture[0]]
    used, view = np.unique(picture, return_inverse=True)
    T_c_o = se3.inverse(poses[used]) @ origin
    X = triangulate(T_c_o, view, point, rays, n)
    distance = MAX_SPACINGS * spacing
    with np.errstate(invalid="ignore", divide="ignore"):
        near = np.linalg.norm(X[:, :3], axis=1) <= distance * np.abs(X[:, 3])
        p = X[:, :3] / X[:, 3:]
    depth = np.einsum("oj,oj->o", T_c_o[view, 2, :3], p[point]) + T_c_o[view, 2, 3]
    near[point[~(depth > 0)]] = False
    kept = np.flatnonzero(near)
    rows = near[point]
    p_w = se3.transform(origin, p[kept])
    return p_w, np.searchsorted(kept, point[rows]), picture[rows], uv[rows]


def _consistent(scene: Scene, poses: Float, eyes: Int) -> Scene:
    """The scene without observations outside of their pictures, and with good points alone."""
    size = np.zeros((len(Eye), 2))
    for eye, camera in scene.cameras.items():
        size[eye] = camera.width, camera.height
    size = size[eyes[scene.picture]]
    inside = ((scene.uv > -0.5) & (scene.uv < size - 0.5)).all(1)
    R, t = poses[:, :3, :3], poses[:, :3, 3]
    away = scene.points_w[scene.point] - t[scene.picture]
    p_c = np.einsum("oji,oj->oi", R[scene.picture], away)
    miss = np.full(len(p_c), np.nan)
    for eye, camera in scene.cameras.items():
        own = eyes[scene.picture] == eye
        miss[own] = np.linalg.norm(camera.project(p_c[own]) - scene.uv[own], axis=1)
    n = len(scene.points_w)
    count = np.bincount(scene.point[inside], minlength=n)
    error = np.bincount(scene.point[inside], miss[inside], n) / np.maximum(count, 1)
    good = (count >= 2) & (error <= MAX_ERROR_PX)
    kept, rows = np.flatnonzero(good), inside & good[scene.point]
    return replace(
        scene,
        points_w=scene.points_w[kept],
        error_px=error[kept],
        point=np.searchsorted(kept, scene.point[rows]),
        picture=scene.picture[rows],
        uv=scene.uv[rows],
    )
