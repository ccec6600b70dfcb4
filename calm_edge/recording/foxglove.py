"""Convert poses, frames and trajectories to Foxglove's protobuf messages, for display.

The conversion loses some content (unit quaternions, no status); the exact values are recorded
beside them, see record.py.
"""

from __future__ import annotations

import logging

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from google.protobuf.timestamp_pb2 import Timestamp

from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.se3 import quaternions
from calm_edge.types import Float, PoseSample, Trajectory
from device.frame import Eye

WORLD_FRAME = "world"
_LEVELS = (
    (logging.CRITICAL, Log.FATAL),
    (logging.ERROR, Log.ERROR),
    (logging.WARNING, Log.WARNING),
    (logging.INFO, Log.INFO),
    (logging.NOTSET, Log.DEBUG),
)


def timestamp(t_ns: int) -> Timestamp:
    """Convert nanoseconds to a protobuf Timestamp, exactly."""
    return Timestamp(seconds=t_ns // 10**9, nanos=t_ns % 10**9)


def camera_frame(eye: Eye) -> str:
    """Return the Foxglove frame id of an eye: `primary` or `assistant`."""
    return eye.name.lower()


def poses(T: Float) -> list[Pose]:
    """Convert rigid transforms (N, 4, 4) to Foxglove poses."""
    made = []
    for t, q in zip(T[:, :3, 3], quaternions(T[:, :3, :3]), strict=True):
        pose = Pose()
        pose.position.x, pose.position.y, pose.position.z = t.tolist()
        o = pose.orientation
        o.x, o.y, o.z, o.w = q.tolist()
        made.append(pose)
    return made


def image(eye: Eye, t_ns: int | None, data: bytes) -> CompressedImage:
    """Wrap the bytes of a PNG or JPEG, unchanged. t_ns: None if the frame's is not its own."""
    kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
    stamp = None if t_ns is None else timestamp(t_ns)
    return CompressedImage(timestamp=stamp, frame_id=camera_frame(eye), data=data, format=kind)


def camera_calibration(eye: Eye, camera: Camera, t_ns: int) -> CameraCalibration:
    """Convert a camera; without rectification."""
    k = [*camera.distortion]
    if isinstance(camera, Fisheye):
        model, size = "kannala_brandt", 4
    else:
        model, size = ("plumb_bob", 5) if len(k) <= 5 else ("rational_polynomial", 8)
    K = camera.matrix
    return CameraCalibration(
        timestamp=timestamp(t_ns),
        frame_id=camera_frame(eye),
        width=camera.width,
        height=camera.height,
        distortion_model=model,
        D=k + [0.0] * (size - len(k)),
        K=K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=np.hstack([K, np.zeros((3, 1))]).ravel().tolist(),
    )


def odometry(sample: PoseSample, t_ns: int) -> Odometry:
    """Convert a live pose: primary camera in the world, velocity and covariance in camera axes."""
    covariance, twist_covariance = sample.with_drift()
    message = Odometry(
        timestamp=timestamp(t_ns),
        frame_id=WORLD_FRAME,
        body_frame_id=camera_frame(Eye.PRIMARY),
        pose=poses(sample.T_w_c[None])[0],
        pose_covariance=_known(covariance),
        velocity_covariance=_known(twist_covariance),
    )
    v, w = message.linear_velocity, message.angular_velocity
    v.x, v.y, v.z = sample.velocity_c.tolist()
    w.x, w.y, w.z = sample.turn_rate_c.tolist()
    return message


def _known(covariance: Float) -> list[float]:
    """The elements of a covariance; zeros, which mark an unknown one, if any is not finite."""
    elements = covariance.ravel().tolist()
    return elements if np.isfinite(covariance).all() else [0.0] * len(elements)


def trajectory(value: Trajectory, t_ns: int) -> PosesInFrame:
    """Convert the poses of all keyframes in the world."""
    return PosesInFrame(timestamp=timestamp(t_ns), frame_id=WORLD_FRAME, poses=poses(value.T_w_c))


def frame_transform(child: str, T_w_child: Float, t_ns: int) -> FrameTransform:
    """Convert T_w_child (4, 4) to the transform of frame `child` in the world."""
    pose = poses(T_w_child[None])[0]
    message = FrameTransform(
        timestamp=timestamp(t_ns),
        parent_frame_id=WORLD_FRAME,
        child_frame_id=child,
        rotation=pose.orientation,
    )
    p = pose.position
    message.translation.x, message.translation.y, message.translation.z = p.x, p.y, p.z
    return message


def log(t_ns: int, level: int, message: str, name: str) -> Log:
    """Convert a log line; level as in Python's logging. Names of files need not be UTF-8."""
    message = message.encode(errors="backslashreplace").decode()
    mapped = next(found for least, found in _LEVELS if level >= least)
    return Log(timestamp=timestamp(t_ns), level=mapped, message=message, name=name)
