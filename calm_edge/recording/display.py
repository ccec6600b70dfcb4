"""Messages for viewers: frames with Z up, odometry, path, clouds, cameras and the kit as numbers.

Frames (REP 103, 105): `map -> odom -> base_link -> primary, assistant`, x forward, y left, z up.
`map` is the body at the first keyframe; z is up if the car stood level there and the mounting of
the camera is configured. Display loses content: the exact values are recorded beside it (`schema`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from calm_edge.config import PoseOutputConfig
from calm_edge.geometry import body_frame, se3
from calm_edge.geometry.camera import Camera, back_project_each
from calm_edge.kit import estimated
from calm_edge.recording import foxglove, plots, schema
from calm_edge.recording.foxglove import BODY_FRAME, MAP_FRAME, ODOM_FRAME
from calm_edge.recording.schema import LogMessage
from calm_edge.types import Float, LocalizerUpdate, PoseSample, PoseStatus
from device.frame import Eye

PATH_EVERY_NS, PATH_POSES = 10_000_000_000, 500
# of the path as a cloud: colour, world units from point to point, and their greatest number
LINE_RGB, LINE_STEP, LINE_POINTS = (78, 152, 226), 0.2, 2000
CLOUD_EVERY_NS, CLOUD_POINTS = 1_000_000_000, 2000


class Display:
    """Converts live poses and updates of one drive to messages for viewers.

    T_map_odom: (4, 4) from the tracker's odometry frame to the map, both in axes of the first
    camera; set when the tracker changes it. origin_ns: as of the TimeBase.
    """

    def __init__(self, mounting: PoseOutputConfig, origin_ns: int = 0) -> None:
        T_frd_c = body_frame.mounting(mounting.mounting_rpy_deg, mounting.mounting_xyz_m)
        self._T_b_c = body_frame.FLU_FROM_FRD @ T_frd_c
        self._origin_ns = origin_ns
        self.T_map_odom: Float = np.eye(4)
        self._T_p_a: Float | None = None
        self._path: dict[int, Float] = {}
        self._path_ns: int | None = None
        self._cloud_ns: int | None = None
        self._newest_ns: int | None = None

    def pose(self, sample: PoseSample) -> list[LogMessage]:
        """Transforms and odometry of a live pose; none of a lost one, which has no values.

        Without a velocity there is no odometry.
        """
        if sample.status is PoseStatus.LOST or not np.isfinite(sample.T_w_c).all():
            return []
        stamp_ns = sample.t_ns - self._origin_ns
        T_o_b = self._body(sample.T_w_c)
        frames = [
            (MAP_FRAME, ODOM_FRAME, self._body(self.T_map_odom)),
            (ODOM_FRAME, BODY_FRAME, T_o_b),
            (BODY_FRAME, foxglove.camera_frame(Eye.PRIMARY), self._T_b_c),
        ]
        if self._T_p_a is not None:
            assistant = foxglove.camera_frame(Eye.ASSISTANT)
            frames.append((BODY_FRAME, assistant, self._T_b_c @ self._T_p_a))
        found = [
            schema.protobuf_message(schema.TF, sample.t_ns, foxglove.transforms(frames, stamp_ns))
        ]
        velocity_c, turn_rate_c = sample.velocity_c, sample.turn_rate_c
        if np.isfinite([velocity_c, turn_rate_c]).all():
            twist = body_frame.body_twist(self._T_b_c, velocity_c, turn_rate_c)
            jacobians = body_frame.local_jacobian(self._T_b_c, T_o_b), se3.adjoint(self._T_b_c)
            pose, change = (
                J @ covariance @ J.T
                for J, covariance in zip(jacobians, sample.with_drift(), strict=True)
            )
            odometry = foxglove.odometry(T_o_b, twist, (pose, change), stamp_ns)
            found.append(schema.protobuf_message(schema.POSE_LIVE, sample.t_ns, odometry))
        return found

    def time_of(self, update: LocalizerUpdate) -> int:
        """Time of the messages of an update: its newest keyframe, but never before earlier ones.

        An update of a window that was solved again tells what is known now, not at its time.
        """
        t_ns = int(update.submap.t_ns.max())
        self._newest_ns = t_ns if self._newest_ns is None else max(t_ns, self._newest_ns)
        return self._newest_ns

    def update(self, update: LocalizerUpdate) -> list[LogMessage]:
        """Path, cloud, cameras and kit after an update."""
        t_ns = self.time_of(update)
        stamp_ns = t_ns - self._origin_ns
        if np.isfinite(update.trajectory.T_p_a).all():
            self._T_p_a = update.trajectory.T_p_a
        found = [
            schema.protobuf_message(
                schema.CALIBRATION_TOPICS[eye],
                t_ns,
                foxglove.camera_calibration(eye, camera, stamp_ns),
            )
            for eye, camera in estimated.cameras(update).items()
        ]
        numbers = kit(update)
        found.append(schema.json_message(schema.KIT, t_ns, numbers))
        found += plots.messages(schema.KIT, t_ns, numbers)
        if self._path_due(update, t_ns):
            self._path_ns = t_ns
            T_m_b = self._body(ordered(self._path))
            path = foxglove.path(thinned(T_m_b), stamp_ns)
            found.append(schema.protobuf_message(schema.PATH, t_ns, path))
            shown = foxglove.cloud(line(T_m_b[:, :3, 3]), stamp_ns, LINE_RGB)
            found.append(schema.protobuf_message(schema.LINE, t_ns, shown))
        due = self._cloud_ns is None or t_ns - self._cloud_ns >= CLOUD_EVERY_NS
        if due and update.prediction.landmarks is not None:
            p_w = landmarks(update)
            self._cloud_ns = t_ns
            p_m = p_w @ self._T_b_c[:3, :3].T + self._T_b_c[:3, 3]
            found.append(schema.protobuf_message(schema.CLOUD, t_ns, foxglove.cloud(p_m, stamp_ns)))
        return found

    def _body(self, T: Float) -> Float:
        """Express motions (..., 4, 4) of the camera as motions of the body."""
        return np.asarray(self._T_b_c @ T @ se3.inverse(self._T_b_c))

    def _path_due(self, update: LocalizerUpdate, t_ns: int) -> bool:
        moved = update.trajectory
        known = zip(moved.keyframe_ids.tolist(), moved.T_w_c, strict=True)
        self._path.update((i, T) for i, T in known if np.isfinite(T).all())
        # an update that moves all keyframes is rare, and the last one of a drive is such
        whole = len(moved.keyframe_ids) >= len(self._path)
        late = self._path_ns is None or t_ns - self._path_ns >= PATH_EVERY_NS
        return bool(self._path) and (late or whole)


def ordered(path: dict[int, Float]) -> Float:
    """Poses (N, 4, 4) of a path in order of their keyframes."""
    return np.stack([path[i] for i in sorted(path)])


def thinned(T: Float) -> Float:
    """At most PATH_POSES of poses (N, 4, 4), the newest included."""
    step = -(-len(T) // PATH_POSES)
    return np.asarray(T[::-1][::step][::-1])


def line(p: Float) -> Float:
    """At most LINE_POINTS points (N, 3) at equal distances along positions p (M, 3)."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1)))
    n = int(np.clip(along[-1] / LINE_STEP, 1, LINE_POINTS - 1)) + 1
    at = np.linspace(0, along[-1], n)
    return np.stack([np.interp(at, along, axis) for axis in p.T], axis=1)


def landmarks(update: LocalizerUpdate) -> Float:
    """At most CLOUD_POINTS landmarks p_w (N, 3) of a sub-map in front of its cameras, world units.

    Each at its depth in the newest view that shows it, consistent with the rectified cameras.
    """
    submap, marks = update.submap, update.prediction.landmarks
    assert marks is not None
    order = np.argsort(-marks.view, kind="stable")
    index, first = np.unique(marks.index[order], return_index=True)
    view, uv = marks.view[order][first], marks.uv[order][first].astype(np.float64)
    T_c_s = se3.inverse(submap.T_s_c_raw[view])
    depth = (T_c_s[:, :3, :3] @ marks.points_s[index][..., None])[:, 2, 0] + T_c_s[:, 2, 3]
    keep = np.flatnonzero(np.isfinite(depth) & (depth > 0))
    keep = keep[:: max(1, -(-len(keep) // CLOUD_POINTS))]
    view, depth = view[keep], depth[keep] * submap.scale
    p_c = back_project_each(submap.cameras, view, uv[keep], depth)
    T_w_c = submap.T_w_c()[view]
    p_w = (T_w_c[:, :3, :3] @ p_c[..., None])[..., 0] + T_w_c[:, :3, 3]
    return np.asarray(p_w[np.isfinite(p_w).all(axis=1)])


def kit(update: LocalizerUpdate) -> dict[str, Any]:
    """Kit after an update as plottable numbers, as in `json_schemas.KIT`."""
    submap, T_p_a = update.submap, update.trajectory.T_p_a
    cameras = {Eye.PRIMARY: submap.cameras[0]}
    if submap.assistant_ids:
        cameras[Eye.ASSISTANT] = submap.cameras[submap.n_primary]
    cameras |= estimated.cameras(update)
    eyes = {
        foxglove.camera_frame(eye): _eye(camera, float(submap.focal_log_sigma[eye]))
        for eye, camera in cameras.items()
    }
    x, y, z = T_p_a[:3, 3].tolist()
    angle = float(np.linalg.norm(se3.so3_log(T_p_a[:3, :3])))
    return {
        **eyes,
        "rig": {"x": x, "y": y, "z": z, "rotation_deg": float(np.degrees(angle))},
        "time_offset_ms": submap.late_ns / 1e6,
        "scale": submap.scale,
        "length_sigma_percent": 100 * update.scale_log_sigma,
        "epoch": submap.kit_epoch,
    }


def _eye(camera: Camera, log_sigma: float) -> dict[str, float]:
    return {
        "focal_px": camera.fx,
        "focal_low_px": camera.fx * np.exp(-log_sigma) if np.isfinite(log_sigma) else np.nan,
        "focal_high_px": camera.fx * np.exp(log_sigma),
        "focal_sigma_percent": 100 * log_sigma,
        "centre_x_px": camera.cx,
        "centre_y_px": camera.cy,
    }
