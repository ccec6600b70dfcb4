"""Convert poses, frames and trajectories to Foxglove's protobuf messages, for display.

The conversion loses some content (unit quaternions, no status); the exact values are recorded
beside them, see record.py.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from google.protobuf.timestamp_pb2 import Timestamp

from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.se3 import quaternions
from calm_edge.types import Float
from device.frame import Eye
from device.gps.fix import Fix

# REP 105; x forward, y left, z up (REP 103)
MAP_FRAME, ODOM_FRAME, BODY_FRAME = "map", "odom", "base_link"
GPS_FRAME = "gps"
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


def odometry(
    T_o_b: Float, twist: tuple[Float, Float], covariances: tuple[Float, Float], t_ns: int
) -> Odometry:
    """Convert the pose T_o_b (4, 4) of the body in ODOM_FRAME.

    twist: velocity (3,) and turn rate (3,) in body axes. covariances: (6, 6) of the pose in axes of
    ODOM_FRAME, and of the twist; published as zeros, which mark an unknown one, if not finite.
    """
    message = Odometry(
        timestamp=timestamp(t_ns),
        frame_id=ODOM_FRAME,
        body_frame_id=BODY_FRAME,
        pose=poses(T_o_b[None])[0],
        pose_covariance=_known(covariances[0]),
        velocity_covariance=_known(covariances[1]),
    )
    v, w = message.linear_velocity, message.angular_velocity
    v.x, v.y, v.z = twist[0].tolist()
    w.x, w.y, w.z = twist[1].tolist()
    return message


def _known(covariance: Float) -> list[float]:
    elements = covariance.ravel().tolist()
    return elements if np.isfinite(covariance).all() else [0.0] * len(elements)


def path(T_m_b: Float, t_ns: int) -> PosesInFrame:
    """Convert poses (N, 4, 4) of the body in MAP_FRAME."""
    return PosesInFrame(timestamp=timestamp(t_ns), frame_id=MAP_FRAME, poses=poses(T_m_b))


def transforms(frames: Iterable[tuple[str, str, Float]], t_ns: int) -> FrameTransforms:
    """Convert transforms (parent, child, T_parent_child)."""
    message = FrameTransforms()
    for parent, child, T in frames:
        pose = poses(T[None])[0]
        transform = message.transforms.add(
            timestamp=timestamp(t_ns),
            parent_frame_id=parent,
            child_frame_id=child,
            rotation=pose.orientation,
        )
        p, t = pose.position, transform.translation
        t.x, t.y, t.z = p.x, p.y, p.z
    return message


def cloud(points_m: Float, t_ns: int, rgb: tuple[int, int, int] | None = None) -> PointCloud:
    """Convert points (N, 3) in MAP_FRAME; as float32, and all in one colour if it is given."""
    colour = np.array([] if rgb is None else [*rgb, 255], np.uint8)
    points = np.zeros(len(points_m), [("xyz", "<f4", 3), ("rgba", "u1", len(colour))])
    points["xyz"], points["rgba"] = points_m, colour
    number, byte = PackedElementField.FLOAT32, PackedElementField.UINT8
    fields = [PackedElementField(name=n, offset=4 * k, type=number) for k, n in enumerate("xyz")]
    names = ("red", "green", "blue", "alpha")[: len(colour)]
    fields += [PackedElementField(name=n, offset=12 + k, type=byte) for k, n in enumerate(names)]
    return PointCloud(
        timestamp=timestamp(t_ns),
        frame_id=MAP_FRAME,
        pose=poses(np.eye(4)[None])[0],
        point_stride=points.dtype.itemsize,
        fields=fields,
        data=points.tobytes(),
    )


def location(fix: Fix, t_ns: int) -> LocationFix:
    """Convert a fix that has a position; covariance [m²] east, north, up."""
    latitude, longitude, height = fix.lla
    kind = LocationFix.DIAGONAL_KNOWN if fix.measured else LocationFix.APPROXIMATED
    return LocationFix(
        timestamp=timestamp(t_ns),
        frame_id=GPS_FRAME,
        latitude=latitude,
        longitude=longitude,
        altitude=height,
        position_covariance=np.diag(np.square(fix.sigma_m)).ravel().tolist(),
        position_covariance_type=kind,
    )


def log(t_ns: int, level: int, message: str, name: str) -> Log:
    """Convert a log line; level as in Python's logging. Names of files need not be UTF-8."""
    message = message.encode(errors="backslashreplace").decode()
    mapped = next(found for least, found in _LEVELS if level >= least)
    return Log(timestamp=timestamp(t_ns), level=mapped, message=message, name=name)
