"""Messages of the sensors beside the cameras: GPS fixes and IMU samples."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from google.protobuf.message import DecodeError

from calm_edge.recording import RecordingError, foxglove, schema
from calm_edge.recording.schema import LogMessage
from device.gps.fix import Fix, FixKind


@dataclass(frozen=True, slots=True)
class ImuSample:
    """Turn rate [rad/s] and acceleration [m/s²] in the axes of an IMU. t_ns: as of frames."""

    t_ns: int
    gyro: tuple[float, float, float]
    accel: tuple[float, float, float]


Sample = Fix | ImuSample


def messages(sample: Sample, origin_ns: int) -> list[LogMessage]:
    """Encode a sample. origin_ns: as of the TimeBase."""
    if isinstance(sample, ImuSample):
        content = {
            name: dict(zip("xyz", values, strict=True))
            for name, values in (("gyro_rad_s", sample.gyro), ("accel_m_s2", sample.accel))
        }
        return [schema.json_message(schema.IMU, sample.t_ns, content)]
    quality = {
        "kind": sample.kind.value,
        "hdop": sample.hdop,
        "satellites": sample.satellites,
        "sigma_m": list(sample.sigma_m),
        "measured": sample.measured,
        "utc_ns": sample.utc_ns,
    }
    found = [schema.json_message(schema.GPS_QUALITY, sample.t_ns, quality)]
    if sample.has_position:
        location = foxglove.location(sample, sample.t_ns - origin_ns)
        found.insert(0, schema.protobuf_message(schema.GPS, sample.t_ns, location))
    return found


def read_fix(t_ns: int, data: bytes, quality: dict[str, Any] | None) -> Fix:
    """Decode a position of /gps. quality: that of the same time. Raises RecordingError."""
    message = LocationFix()
    try:
        message.ParseFromString(data)
    except DecodeError as error:
        raise RecordingError(f"{schema.GPS}: not a fix ({error})") from None
    variances = np.array(message.position_covariance or [np.inf] * 9).reshape(3, 3)
    east, north, up = np.sqrt(np.diag(variances)).tolist()
    quality = quality or {}
    hdop, satellites, utc_ns = (quality.get(key) for key in ("hdop", "satellites", "utc_ns"))
    return Fix(
        t_ns,
        utc_ns,
        (message.latitude, message.longitude, message.altitude),
        (east, north, up),
        FixKind(quality.get("kind", FixKind.UNKNOWN)),
        message.position_covariance_type == LocationFix.DIAGONAL_KNOWN,
        float("nan") if hdop is None else hdop,
        satellites,
    )


def read_imu(t_ns: int, content: dict[str, Any]) -> ImuSample:
    """Convert an object of /imu; raises RecordingError."""
    try:
        gyro, accel = (
            (float(content[name]["x"]), float(content[name]["y"]), float(content[name]["z"]))
            for name in ("gyro_rad_s", "accel_m_s2")
        )
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"{schema.IMU}: not a sample ({error!r})") from None
    return ImuSample(t_ns, gyro, accel)
