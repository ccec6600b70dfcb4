"""A ROS 2 bag (MCAP) with pictures, cameras, transforms, odometry, path and cloud, by rosbags.

Frames as in REP 103 and 105: `map` is levelled, z up; `base_link` is at the primary camera, x along
its axis, y left, z up. `primary` and `assistant` have a picture's axes: x right, y down, z ahead.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.interchange import InterchangeError
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.cloud import level_of, levelled
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.frame_poses import FramePoses
from calm_edge.interchange.export.ros2_messages import Messages
from calm_edge.interchange.export.scene import lenses
from calm_edge.interchange.ros_bag import require_rosbags
from calm_edge.types import Float
from device.frame import Eye

BAG = "bag"
# x along the axis, y left, z up, of axes x right, y down, z ahead
T_BODY_PRIMARY = se3.compose(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), np.zeros(3))
# longest time over which a velocity is a difference of positions
MAX_STEP_S = 0.5


class Ros2:
    """`bag/`: a folder as of `ros2 bag record`."""

    name = "ros2"
    writes = "ROS 2 bag with pictures, camera_info, tf, odometry, path and cloud"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the bag; raises InterchangeError."""
        require_rosbags()
        found = level_of(drive)
        T_map_w = se3.compose(found.R_l_w, np.zeros(3))
        assumed: list[str] = []
        cameras = lenses(drive.last, assumed)
        poses = drive.frame_poses()
        first = min(int(each.t_ns[0]) for each in poses.values()) + drive.stamp_ns
        if first < 0:
            raise InterchangeError(f"{drive.path}: stamps before 0 s, which ROS does not have")
        T_map_body = T_map_w @ poses[Eye.PRIMARY].T_w_c @ se3.inverse(T_BODY_PRIMARY)
        known = poses[Eye.PRIMARY].known
        own = drive.own_ns(poses[Eye.PRIMARY].t_ns[known]).tolist()
        twists = _twists(poses[Eye.PRIMARY], T_map_body)
        with _Bag(folder / BAG) as bag:
            links = [("base_link", "primary", T_BODY_PRIMARY)]
            if Eye.ASSISTANT in poses:
                links.append(("primary", "assistant", drive.keyframes.T_p_a))
            bag.write("/tf_static", first, bag.make.transforms(first, links))
            places = dict(zip(poses[Eye.PRIMARY].t_ns.tolist(), T_map_body, strict=True))
            pictures, last = _write_frames(bag, drive, cameras, places, twists)
            if own:
                bag.write("/path", last, bag.make.path(own, T_map_body[known]))
            points = 0
            for tile in levelled(drive).tiles() if drive.cloud is not None else ():
                bag.write("/cloud", last, bag.make.cloud(last, tile))
                points += len(tile.points_w)
        left_out = ["covariances of the odometry (--to csv)"]
        if drive.cloud is None:
            left_out.append("cloud: only a map has one")
        if not known.all():
            left_out.append(f"transforms of {int((~known).sum())} frames: without a pose")
        return Written(
            (
                f"{BAG}: {pictures} pictures with camera_info, tf map -> base_link -> primary -> "
                f"assistant, {len(twists)} odometry, path of {len(own)} poses, {points} points",
            ),
            (
                "map is x ahead at the start, y left, z up; base_link is at the primary camera",
                found.described(),
                f"lengths in {drive.unit}",
                f"stamps {drive.stamps}; poses at the middle row",
                "the assistant's transform is the rig: its time offset is not in the stamps",
                *assumed,
            ),
            tuple(left_out),
        )


def _write_frames(
    bag: _Bag,
    drive: ExportedDrive,
    cameras: dict[Eye, Camera],
    places: dict[int, Float],
    twists: dict[int, Float],
) -> tuple[int, int]:
    """Write what belongs to each frame; return the number of pictures and the last stamp.

    places: T_map_body (4, 4) of the primary's frames, NaN without a pose; twists: (6,) of some.
    """
    make, pictures, t = bag.make, 0, 0
    for frame in drive.recording.frames():
        t, name = frame.t_ns + drive.stamp_ns, frame.eye.name.lower()
        assert isinstance(frame.image, bytes)
        bag.write(f"/{name}/image_raw/compressed", t, make.picture(t, name, frame.image))
        pictures += 1
        if frame.eye in cameras:
            info = make.camera_info(t, name, cameras[frame.eye])
            bag.write(f"/{name}/camera_info", t, info)
        if frame.eye is Eye.PRIMARY and np.isfinite(places[frame.t_ns]).all():
            T = places[frame.t_ns]
            bag.write("/tf", t, make.transforms(t, [("map", "base_link", T)]))
            if frame.t_ns in twists:
                bag.write("/odometry", t, make.odometry(t, T, twists[frame.t_ns]))
    return pictures, t


class _Bag:
    """Context manager of a bag to write; a topic is added with its first message."""

    def __init__(self, path: Path) -> None:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore

        self._store: Any = get_typestore(Stores.ROS2_HUMBLE)
        self._writer: Any = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Any] = {}
        self.make = Messages(self._store)

    def __enter__(self) -> _Bag:
        self._writer.open()
        return self

    def __exit__(self, *exception: object) -> None:
        self._writer.close()

    def write(self, topic: str, t_ns: int, message: Any) -> None:
        """Write a message with t_ns as its log time."""
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic,
                kind,
                typestore=self._store,
                offered_qos_profiles=_latched() if topic == "/tf_static" else (),
            )
        self._writer.write(self._connections[topic], t_ns, self._store.serialize_cdr(message, kind))


def _latched() -> list[Any]:
    """Quality of service of /tf_static: kept for nodes that subscribe later."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    never = QosTime(2147483647, 4294967295)
    return [
        Qos(
            history=QosHistory.KEEP_LAST,
            depth=1,
            reliability=QosReliability.RELIABLE,
            durability=QosDurability.TRANSIENT_LOCAL,
            deadline=never,
            lifespan=never,
            liveliness=QosLiveliness.AUTOMATIC,
            liveliness_lease_duration=never,
            avoid_ros_namespace_conventions=False,
        )
    ]


def _twists(poses: FramePoses, T_map_body: Float) -> dict[int, Float]:
    """Velocity and turn rate (6,) in the body's axes, by stamp: central differences of poses."""
    found = {}
    t_ns, known = poses.t_ns, poses.known
    for i in range(1, len(t_ns) - 1):
        seconds = float(t_ns[i + 1] - t_ns[i - 1]) / 1e9
        if known[i - 1 : i + 2].all() and seconds <= MAX_STEP_S:
            before, now, after = T_map_body[i - 1 : i + 2]
            velocity = now[:3, :3].T @ (after - before)[:3, 3]
            turn = se3.so3_log(before[:3, :3].T @ after[:3, :3])
            found[int(t_ns[i])] = np.concatenate([velocity, turn]) / seconds
    return found
