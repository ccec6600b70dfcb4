"""Messages of ROS 2: times, transforms, cameras, odometry, paths and clouds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.interchange.calibration.ros import distortion_of
from calm_edge.types import Float, MapTile

POINT = np.dtype([("p", "<f4", 3), ("rgb", "<u4")])


class Messages:
    """Builds messages of a type store of rosbags."""

    def __init__(self, store: Any) -> None:
        self._types = store.types

    def header(self, t_ns: int, frame: str) -> Any:
        """Header with a stamp and a frame."""
        seconds, rest = divmod(t_ns, 10**9)
        stamp = self._types["builtin_interfaces/msg/Time"](seconds, rest)
        return self._types["std_msgs/msg/Header"](stamp, frame)

    def picture(self, t_ns: int, frame: str, data: bytes) -> Any:
        """A JPEG or PNG, unchanged."""
        kind = "png" if data.startswith(b"\x89PNG") else "jpeg"
        make = self._types["sensor_msgs/msg/CompressedImage"]
        return make(self.header(t_ns, frame), kind, np.frombuffer(data, np.uint8))

    def camera_info(self, t_ns: int, frame: str, camera: Camera) -> Any:
        """A camera, without rectification."""
        model, k = distortion_of(camera)
        K = camera.matrix
        return self._types["sensor_msgs/msg/CameraInfo"](
            header=self.header(t_ns, frame),
            height=camera.height,
            width=camera.width,
            distortion_model=model,
            d=np.array(k),
            k=K.ravel(),
            r=np.eye(3).ravel(),
            p=np.hstack([K, np.zeros((3, 1))]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=self._types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
        )

    def transforms(self, t_ns: int, links: Sequence[tuple[str, str, Float]]) -> Any:
        """A message of tf with links: parent, child, T_parent_child (4, 4)."""
        make = self._types
        made = [
            make["geometry_msgs/msg/TransformStamped"](
                self.header(t_ns, parent),
                child,
                make["geometry_msgs/msg/Transform"](self._vector(T[:3, 3]), self._rotation(T)),
            )
            for parent, child, T in links
        ]
        return make["tf2_msgs/msg/TFMessage"](made)

    def odometry(self, t_ns: int, T_map_body: Float, twist: Float) -> Any:
        """Odometry; twist: (6,) velocity and turn rate, in the axes of the body.

        Covariances are zero, which means unknown.
        """
        make = self._types
        unknown = np.zeros(36)
        pose = make["geometry_msgs/msg/PoseWithCovariance"](self._pose(T_map_body), unknown)
        rates = make["geometry_msgs/msg/Twist"](self._vector(twist[:3]), self._vector(twist[3:]))
        moving = make["geometry_msgs/msg/TwistWithCovariance"](rates, unknown)
        header = self.header(t_ns, "map")
        return make["nav_msgs/msg/Odometry"](header, "base_link", pose, moving)

    def path(self, t_ns: Sequence[int], T_map_body: Float) -> Any:
        """Poses (N, 4, 4) at t_ns (N,), stamped with the last."""
        stamped = self._types["geometry_msgs/msg/PoseStamped"]
        poses = [
            stamped(self.header(t, "map"), self._pose(T))
            for t, T in zip(t_ns, T_map_body, strict=True)
        ]
        return self._types["nav_msgs/msg/Path"](self.header(t_ns[-1], "map"), poses)

    def cloud(self, t_ns: int, tile: MapTile) -> Any:
        """Points with colours."""
        field = self._types["sensor_msgs/msg/PointField"]
        fields = [field(a, 4 * i, field.FLOAT32, 1) for i, a in enumerate("xyz")]
        fields.append(field("rgb", 12, field.UINT32, 1))
        points = np.empty(len(tile.points_w), POINT)
        points["p"] = tile.points_w
        r, g, b = tile.color.astype(np.uint32).T
        points["rgb"] = r << 16 | g << 8 | b
        return self._types["sensor_msgs/msg/PointCloud2"](
            header=self.header(t_ns, "map"),
            height=1,
            width=len(points),
            fields=fields,
            is_bigendian=False,
            point_step=POINT.itemsize,
            row_step=points.nbytes,
            data=np.frombuffer(points.tobytes(), np.uint8),
            is_dense=True,
        )

    def _pose(self, T: Float) -> Any:
        make = self._types
        point = make["geometry_msgs/msg/Point"](*T[:3, 3].tolist())
        return make["geometry_msgs/msg/Pose"](point, self._rotation(T))

    def _vector(self, v: Float) -> Any:
        return self._types["geometry_msgs/msg/Vector3"](*v.tolist())

    def _rotation(self, T: Float) -> Any:
        q = se3.quaternions(T[None, :3, :3])[0]
        return self._types["geometry_msgs/msg/Quaternion"](*q.tolist())
