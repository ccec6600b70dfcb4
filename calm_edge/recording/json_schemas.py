"""JSON schemas of the topics in JSON, by which viewers offer their numbers for plotting."""

from __future__ import annotations

from typing import Any

_NUMBER: dict[str, Any] = {"type": "number"}
_OPTIONAL: dict[str, Any] = {"type": ["number", "null"]}
_NUMBERS: dict[str, Any] = {"type": "object", "additionalProperties": _OPTIONAL}
_TEXT: dict[str, Any] = {"type": "string"}


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


CLOCK = _object(
    realtime_ns={"type": "integer"},
    monotonic_ns={"type": "integer"},
    synchronised={"type": "boolean"},
)
STATUS = _object()
# a moment that somebody marked
EVENT = _object(text=_TEXT)
HEALTH = _object(
    state=_TEXT,
    reasons={"type": "array", "items": _TEXT},
    shed=_TEXT,
    tick=_NUMBERS,
    late_ticks=_NUMBER,
    counts=_NUMBERS,
    drops=_NUMBERS,
    queues=_NUMBERS,
    stage_ms=_NUMBERS,
    pose_age_ms=_OPTIONAL,
    disk=_object(
        error=_TEXT,
        free_bytes=_OPTIONAL,
        floor_bytes=_NUMBER,
        bytes_per_s=_NUMBER,
        left_s=_OPTIONAL,
        sync_ms=_NUMBER,
        kept={"type": "boolean"},
    ),
    celsius=_OPTIONAL,
    throttled={"type": ["boolean", "null"]},
)
# focal_low_px and focal_high_px: one sigma about focal_px; null while the sigma is unknown
_EYE = _object(
    focal_px=_NUMBER,
    focal_low_px=_OPTIONAL,
    focal_high_px=_OPTIONAL,
    focal_sigma_percent=_OPTIONAL,
    centre_x_px=_NUMBER,
    centre_y_px=_NUMBER,
)
# rig: centre of the assistant in the primary camera, world units, and its rotation
KIT = _object(
    primary=_EYE,
    assistant=_EYE,
    rig=_object(x=_NUMBER, y=_NUMBER, z=_NUMBER, rotation_deg=_NUMBER),
    time_offset_ms=_NUMBER,
    scale=_NUMBER,
    length_sigma_percent=_OPTIONAL,
    epoch=_NUMBER,
)
GPS_QUALITY = _object(
    kind=_TEXT,
    hdop=_OPTIONAL,
    satellites=_OPTIONAL,
    sigma_m={"type": "array", "items": _NUMBER},
    measured={"type": "boolean"},
    utc_ns={"type": ["integer", "null"]},
)
_VECTOR = _object(x=_NUMBER, y=_NUMBER, z=_NUMBER)
IMU = _object(gyro_rad_s=_VECTOR, accel_m_s2=_VECTOR)
