"""Topics of a recording, their schemas, and conversion of each data type to messages and back.

| topic | schema | time of the message |
|---|---|---|
| /primary/image, /assistant/image | foxglove.CompressedImage | Frame.t_ns |
| /pose/live | foxglove.Odometry of `base_link` in `odom`, none while lost | PoseSample.t_ns |
| /pose/sample | calm_edge.PoseSample: the same pose, exact | PoseSample.t_ns |
| /pose/path | foxglove.PosesInFrame: at most 500, every 10 s | as /submap |
| /pose/line | foxglove.PointCloud: the same path in close points | as /submap |
| /tf | foxglove.FrameTransforms: `map`, `odom`, `base_link`, the cameras | PoseSample.t_ns |
| /cloud | foxglove.PointCloud: landmarks of a new sub-map in `map` | as /submap |
| /kit | JSON: focal lengths, their sigmas, rig ... | as /submap |
| /primary/calibration | foxglove.CameraCalibration, once the focal is observed | as /submap |
| /assistant/calibration | the same of the other camera | as /submap |
| /submap | calm_edge.Submap: the LocalizerUpdate | newest keyframe of all sub-maps so far |
| /window | calm_edge.Window: keys of the window's frames | its newest keyframe |
| /clock, /status, /health | JSON | time of writing |
| /plot/... | std_msgs/msg/Float64MultiArray: see PLOTS | as /kit or /health |
| /gps | foxglove.LocationFix with its covariance, none while there is no position | its arrival |
| /gps/quality | JSON: kind of fix, dilution, satellites, time by GPS | its arrival |
| /imu | JSON: turn rate and acceleration, of an import | its stamp |
| /log | foxglove.Log | time of logging |

That time, t_ns, is MCAP's publish_time, and the arrival at the recorder its log_time, which never
decreases; both in Unix time, and stamps within messages are the user's: see `time_base`. In a
recording of version 0.1.0, log_time is t_ns. An image without Frame.own_stamp has no timestamp of
its own.
An update is stored exactly except for depth (fp16; beyond its range: 0, unknown) and confidence
(uint8, steps of 1/255); storing an update read from a recording changes nothing more.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from google.protobuf.message import DecodeError
from mcap_protobuf.schema import build_file_descriptor_set

from calm_edge.kit import earlier
from calm_edge.recording import (
    RecordingError,
    camera_record,
    float_array,
    foxglove,
    json_schemas,
    record,
)
from calm_edge.recording.time_base import synchronised
from calm_edge.recording.topic_schema import TopicSchema
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import LocalizerUpdate, PoseSample
from device.frame import Eye, Frame

CALIBRATION_TOPICS = {
    Eye.PRIMARY: "/primary/calibration",
    Eye.ASSISTANT: "/assistant/calibration",
}
IMAGE_TOPICS = {Eye.PRIMARY: "/primary/image", Eye.ASSISTANT: "/assistant/image"}
POSE_LIVE, POSE_SAMPLE = "/pose/live", "/pose/sample"
PATH, LINE = "/pose/path", "/pose/line"
TF, SUBMAP, WINDOW, CLOCK, STATUS, LOG = "/tf", "/submap", "/window", "/clock", "/status", "/log"
HEALTH, KIT, CLOUD, EVENT = "/health", "/kit", "/cloud", "/event"
GPS, GPS_QUALITY, IMU = "/gps", "/gps/quality", "/imu"

CONFIG_METADATA = "calm_edge.config"
SESSION_METADATA = "calm_edge.session"
CAMERAS_METADATA = "calm_edge.cameras"
IMPORT_METADATA = "calm_edge.import"
# In the last segment of a recording that was closed, or recovered from a file cut short, if the
# session's metadata holds END_KEY.
END_METADATA = "calm_edge.end"
END_KEY = "end"

_PROTOBUF: dict[str, Any] = {
    **dict.fromkeys(IMAGE_TOPICS.values(), CompressedImage),
    **dict.fromkeys(CALIBRATION_TOPICS.values(), CameraCalibration),
    POSE_LIVE: Odometry,
    POSE_SAMPLE: record.message_class("PoseSample"),
    PATH: PosesInFrame,
    LINE: PointCloud,
    TF: FrameTransforms,
    CLOUD: PointCloud,
    SUBMAP: record.message_class("Submap"),
    WINDOW: record.message_class("Window"),
    LOG: Log,
    GPS: LocationFix,
}
_JSON = {
    CLOCK: ("calm_edge.Clock", json_schemas.CLOCK),
    STATUS: ("calm_edge.Status", json_schemas.STATUS),
    HEALTH: ("calm_edge.Health", json_schemas.HEALTH),
    KIT: ("calm_edge.Kit", json_schemas.KIT),
    EVENT: ("calm_edge.Event", json_schemas.EVENT),
    GPS_QUALITY: ("calm_edge.GpsQuality", json_schemas.GPS_QUALITY),
    IMU: ("calm_edge.Imu", json_schemas.IMU),
}
# by the topic that holds them as JSON: topics of the same numbers for viewers that plot no JSON
# (rerun), and where each number of their arrays is in the JSON
PLOTS: dict[str, dict[str, tuple[str, ...]]] = {
    KIT: {
        "/plot/primary/focal_px": (
            "primary.focal_px",
            "primary.focal_low_px",
            "primary.focal_high_px",
        ),
        "/plot/assistant/focal_px": (
            "assistant.focal_px",
            "assistant.focal_low_px",
            "assistant.focal_high_px",
        ),
        "/plot/length_sigma_percent": ("length_sigma_percent",),
        "/plot/time_offset_ms": ("time_offset_ms",),
    },
    HEALTH: {
        "/plot/pose_age_ms": ("pose_age_ms",),
        "/plot/tick_p99_ms": ("tick.p99_ms",),
        "/plot/windows_waiting": ("queues.estimator_windows",),
    },
}
_PLOT_TOPICS = tuple(topic for topics in PLOTS.values() for topic in topics)
TOPICS = (*_PROTOBUF, *_JSON, *_PLOT_TOPICS)


@dataclass(frozen=True, slots=True)
class LogMessage:
    """An encoded message: t_ns as of frames, data in the topic's schema.

    Raises RecordingError for times that MCAP cannot hold.
    """

    topic: str
    t_ns: int
    data: bytes
    sequence: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.t_ns < 1 << 63:
            raise RecordingError(f"{self.topic}: time {self.t_ns} ns is out of range for MCAP")


def topic_schema(topic: str) -> TopicSchema:
    """Return the schema of one of TOPICS."""
    if topic in _JSON:
        name, content = _JSON[topic]
        return TopicSchema(name, "jsonschema", json.dumps(content).encode(), "json")
    if topic in _PLOT_TOPICS:
        return float_array.SCHEMA
    kind = _PROTOBUF[topic]
    description = build_file_descriptor_set(kind).SerializeToString(deterministic=True)
    return TopicSchema(str(kind.DESCRIPTOR.full_name), "protobuf", description, "protobuf")


def protobuf_message(topic: str, t_ns: int, content: Any, sequence: int = 0) -> LogMessage:
    """Encode a protobuf message."""
    return LogMessage(topic, t_ns, bytes(content.SerializeToString()), sequence)


def frame_message(frame: Frame, origin_ns: int = 0) -> LogMessage:
    """Encode a frame's JPEG or PNG bytes, unchanged. origin_ns: as of the TimeBase."""
    assert isinstance(frame.image, bytes)
    stamp = frame.t_ns - origin_ns if frame.own_stamp else None
    image = foxglove.image(frame.eye, stamp, frame.image)
    return protobuf_message(IMAGE_TOPICS[frame.eye], frame.t_ns, image, frame.sequence)


def read_frame(eye: Eye, sequence: int, t_ns: int, data: bytes) -> Frame:
    """Decode an image message to a frame with the bytes as recorded; raises RecordingError."""
    message = CompressedImage()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise RecordingError(f"{IMAGE_TOPICS[eye]} {sequence}: not an image ({error})") from None
    own_stamp = message.HasField("timestamp")
    return Frame(eye, sequence, t_ns, bytes(message.data), own_stamp)


def pose_message(sample: PoseSample) -> LogMessage:
    """Encode a live pose exactly; for viewers, see `display`."""
    data = record.encode("PoseSample", *record.flatten(sample))
    return LogMessage(POSE_SAMPLE, sample.t_ns, data)


def read_pose(data: bytes) -> PoseSample:
    """Decode a pose of /pose/sample; raises RecordingError."""
    return record.unflatten(PoseSample, *record.decode("PoseSample", data))


def update_message(update: LocalizerUpdate, log_depth: bool, t_ns: int) -> LogMessage:
    """Encode an update exactly except depth (see the module); for viewers, see `display`.

    t_ns: time of the message.
    """
    header, arrays = record.flatten(update)
    depth = arrays.pop("prediction.depth", None)
    confidence = arrays.pop("prediction.confidence", None)
    if log_depth and depth is not None:
        representable = np.isfinite(depth) & (np.abs(depth) <= np.finfo(np.float16).max)
        arrays["prediction.depth"] = np.where(representable, depth, 0).astype(np.float16)
        if confidence is not None:
            steps = np.rint(np.clip(np.nan_to_num(confidence), 0, 1) * 255)
            arrays["prediction.confidence"] = steps.astype(np.uint8)
    return LogMessage(SUBMAP, t_ns, record.encode("Submap", header, arrays))


def read_update(data: bytes, size_of: Callable[[Eye], tuple[int, int]]) -> LocalizerUpdate:
    """Decode an update of /submap, depth and confidence as float32; raises RecordingError.

    size_of: returns width, height [px] of an eye's images; called only for updates of version
    0.1.0, which contain 3x3 matrices instead of cameras.
    """
    header, arrays = record.decode("Submap", data)
    camera_record.replace_matrices(header, arrays, size_of)
    _convert_kits(arrays)
    if "prediction.depth" in arrays:
        arrays["prediction.depth"] = arrays["prediction.depth"].astype(np.float32)
    if "prediction.confidence" in arrays:
        steps = arrays["prediction.confidence"].astype(np.float32)
        arrays["prediction.confidence"] = steps / np.float32(255)
    return record.unflatten(LocalizerUpdate, header, arrays)


def _convert_kits(arrays: record.Arrays) -> None:
    """Convert the kits in an update of version 0.1.0, in place."""
    for kit in ("kit.", "prediction.kit."):
        for name in ("mean", "information", "noise", "measured"):
            if kit + name in arrays:
                arrays[kit + name] = earlier.converted(arrays[kit + name])
    for name in ("prediction.overlap.kit", "prediction.overlap.by_kit"):
        if name in arrays:
            arrays[name] = earlier.converted(arrays[name])


def window_message(window: WindowRecord) -> LogMessage:
    """Encode the record of a window's frames."""
    data = record.encode("Window", *record.flatten(window))
    return LogMessage(WINDOW, int(window.t_ns.max()), data)


def read_window(data: bytes) -> WindowRecord:
    """Decode a record of /window; raises RecordingError."""
    return record.unflatten(WindowRecord, *record.decode("Window", data))


def clock_message(t_ns: int, realtime_ns: int, monotonic_ns: int) -> LogMessage:
    """Encode a simultaneous reading of the wall clock and the host-monotonic clock."""
    reading = {
        "realtime_ns": realtime_ns,
        "monotonic_ns": monotonic_ns,
        "synchronised": synchronised(),
    }
    return json_message(CLOCK, t_ns, reading)


def json_message(topic: str, t_ns: int, value: Mapping[str, Any]) -> LogMessage:
    """Encode a JSON object; other types as text, numbers that JSON does not have as null."""
    text = json.dumps(finite(value), default=str, allow_nan=False)
    return LogMessage(topic, t_ns, text.encode())


def finite(value: Any) -> Any:
    """Replace numbers that JSON does not have by None, in mappings and lists too."""
    if isinstance(value, Mapping):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def log_message(t_ns: int, level: int, message: str, name: str, origin_ns: int = 0) -> LogMessage:
    """Encode a log line; level as in Python's logging. origin_ns: as of the TimeBase."""
    return protobuf_message(LOG, t_ns, foxglove.log(t_ns - origin_ns, level, message, name))
