"""Small bags with two cameras, written by rosbags and by the MCAP library."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer as McapWriter
from mcap_protobuf.schema import build_file_descriptor_set
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from calm_edge.types import Float
from device.frame import jpeg
from tests.interchange.moving import Picture, pictures

# stamps are those of an ordinary computer, and messages are logged later
START_NS = 1_700_000_000_000_000_000
DELAY_NS = 3_000_000
K = (100.0, 0.0, 80.0, 0.0, 100.0, 48.0, 0.0, 0.0, 1.0)
BASELINE_M = 0.5


def shown(t: Float, eye: int) -> list[Picture]:
    """Colour pictures of an eye."""
    return [np.repeat(p[:, :, None], 3, axis=2) for p in pictures(t + 0.1 * eye)]


class RosTypes:
    """Messages of ROS 1 or ROS 2 by rosbags."""

    def __init__(self, ros1: bool) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        self.ros1 = ros1

    def make(self, kind: str, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, t_ns: int) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        sequence = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id="camera", **sequence)

    def compressed(self, t_ns: int, picture: Picture) -> Any:
        data = np.frombuffer(jpeg(picture), np.uint8)
        kind = "sensor_msgs/msg/CompressedImage"
        return self.make(kind, header=self.header(t_ns), format="jpeg", data=data)

    def raw(self, t_ns: int, picture: Picture) -> Any:
        height, width = picture.shape[:2]
        return self.make(
            "sensor_msgs/msg/Image", header=self.header(t_ns), height=height, width=width,
            encoding="bgr8", is_bigendian=0, step=3 * width, data=picture.ravel(),
        )  # fmt: skip

    def info(self, t_ns: int, size: tuple[int, int], x_m: float) -> Any:
        P = np.array([*K[:3], -K[0] * x_m, *K[3:6], 0.0, *K[6:], 0.0])
        values = {"D": np.zeros(5), "K": np.array(K), "R": np.eye(3).ravel(), "P": P}
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False,
        )  # fmt: skip
        return self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(t_ns), height=size[1], width=size[0],
            distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi,
            **{key if self.ros1 else key.lower(): value for key, value in values.items()},
        )  # fmt: skip

    def fix(self, t_ns: int) -> Any:
        status = self.make("sensor_msgs/msg/NavSatStatus", status=0, service=1)
        return self.make(
            "sensor_msgs/msg/NavSatFix", header=self.header(t_ns), status=status, latitude=48.5,
            longitude=9.25, altitude=400.0, position_covariance=np.eye(3).ravel(),
            position_covariance_type=2,
        )  # fmt: skip

    def imu(self, t_ns: int) -> Any:
        def vector(*values: float) -> Any:
            return self.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", values, strict=True)))

        unknown = {
            f"{name}_covariance": np.zeros(9)
            for name in ("orientation", "angular_velocity", "linear_acceleration")
        }
        return self.make(
            "sensor_msgs/msg/Imu", header=self.header(t_ns),
            orientation=self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
            angular_velocity=vector(0.1, 0.2, 0.3), linear_acceleration=vector(0.0, 0.5, 9.8),
            **unknown,
        )  # fmt: skip


def write_ros(
    path: Path, t: Float, *, ros1: bool = False, mcap: bool = False, raw: bool = False
) -> Path:
    """Write a bag with /left, /right (Image or CompressedImage), camera_info, /fix and /imu."""
    types = RosTypes(ros1)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    writer: Any = Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin)
    pixels = [shown(t, eye) for eye in range(2)]
    size = pixels[0][0].shape[1], pixels[0][0].shape[0]
    with writer:
        connections: dict[str, Any] = {}

        def write(topic: str, t_ns: int, message: Any) -> None:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types.store)
            serialize = types.store.serialize_ros1 if ros1 else types.store.serialize_cdr
            writer.write(connections[topic], t_ns + DELAY_NS, serialize(message, kind))

        for k, moment in enumerate(t):
            t_ns = START_NS + round(1e9 * moment)
            for eye, name in enumerate(("left", "right")):
                write(f"/{name}/camera_info", t_ns, types.info(t_ns, size, BASELINE_M * eye))
                make = types.raw if raw else types.compressed
                topic = f"/{name}/image_raw" + ("" if raw else "/compressed")
                write(topic, t_ns, make(t_ns, pixels[eye][k]))
            write("/fix", t_ns, types.fix(t_ns))
            for part in range(4):
                write("/imu", t_ns + part * 10**7, types.imu(t_ns + part * 10**7))
            if k == 0:
                write("/spare/fix", t_ns, types.fix(t_ns))
    return path


def write_foxglove(
    path: Path,
    t: Float,
    topics: tuple[str, ...] = ("/camera/left", "/camera/right"),
    kind: str = "compressed",
) -> Path:
    """Write an MCAP file with Foxglove's messages. kind: compressed, raw or json."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        message = RawImage if kind == "raw" else CompressedImage
        name = message.DESCRIPTOR.full_name
        description = build_file_descriptor_set(message).SerializeToString()
        encoding = "json" if kind == "json" else "protobuf"
        schema = writer.register_schema(
            name, "jsonschema" if encoding == "json" else encoding,
            b"{}" if encoding == "json" else description,
        )  # fmt: skip
        channels = [writer.register_channel(topic, encoding, schema) for topic in topics]
        pixels = [shown(t, eye) for eye in range(len(topics))]
        encode: Callable[[int, Picture], bytes] = _ENCODE[kind]
        for k, moment in enumerate(t):
            t_ns = START_NS + round(1e9 * moment)
            for eye, channel in enumerate(channels):
                data = encode(t_ns, pixels[eye][k])
                writer.add_message(channel, t_ns + DELAY_NS, data, t_ns + DELAY_NS)
        writer.finish()
    return path


def _compressed(t_ns: int, picture: Picture) -> bytes:
    stamp = Timestamp(seconds=t_ns // 10**9, nanos=t_ns % 10**9)
    message = CompressedImage(timestamp=stamp, data=jpeg(picture), format="jpeg")
    return bytes(message.SerializeToString())


def _raw(t_ns: int, picture: Picture) -> bytes:
    stamp = Timestamp(seconds=t_ns // 10**9, nanos=t_ns % 10**9)
    height, width = picture.shape[:2]
    # rows may be longer than the picture
    padded = np.pad(picture.reshape(height, 3 * width), ((0, 0), (0, 8)))
    return bytes(
        RawImage(
            timestamp=stamp, width=width, height=height, encoding="bgr8", step=padded.shape[1],
            data=padded.tobytes(),
        ).SerializeToString()
    )  # fmt: skip


def _json(t_ns: int, picture: Picture) -> bytes:
    stamp = {"sec": t_ns // 10**9, "nsec": t_ns % 10**9}
    data = base64.b64encode(jpeg(picture)).decode()
    message = {"timestamp": stamp, "frame_id": "c", "data": data, "format": "jpeg"}
    return json.dumps(message).encode()


_ENCODE: dict[str, Callable[[int, Picture], bytes]] = {
    "compressed": _compressed,
    "raw": _raw,
    "json": _json,
}
