"""Pictures and stamps of ROS and Foxglove messages."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.interchange import InterchangeError
from device.frame import jpeg

RAW = frozenset({"sensor_msgs/msg/Image", "foxglove.RawImage", "foxglove_msgs/msg/RawImage"})
COMPRESSED = frozenset(
    {
        "sensor_msgs/msg/CompressedImage",
        "foxglove.CompressedImage",
        "foxglove_msgs/msg/CompressedImage",
    }
)
PICTURES = RAW | COMPRESSED

# encoding -> (bytes a pixel, conversion to BGR or grey). OpenCV names a Bayer pattern by its second
# row and column, ROS by its first.
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "bgr8": (3, None),
    "8uc3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "mono8": (1, None),
    "8uc1": (1, None),
    "bayer_rggb8": (1, cv2.COLOR_BayerBG2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerRG2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGR2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGB2BGR),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
    "mono16": (2, None),
}


def stamp_ns(kind: str, message: Any) -> int:
    """Stamp of a message [ns], 0 if it has none."""
    found = message.timestamp if hasattr(message, "timestamp") else message.header.stamp
    if hasattr(found, "seconds"):
        return int(found.seconds) * 10**9 + int(found.nanos)
    return int(found.sec) * 10**9 + int(found.nanosec)


def encoded(topic: str, kind: str, message: Any, quality: int) -> bytes:
    """JPEG or PNG bytes of a picture, unchanged if it is one; raises InterchangeError."""
    data = bytes(memoryview(message.data))
    if kind in RAW:
        return jpeg(pixels(topic, message, data), quality)
    if data.startswith((b"\xff\xd8", b"\x89PNG")):
        return data
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) if data else None
    if picture is None:
        raise InterchangeError(
            f"{topic}: a message of format {message.format!r} is no picture; jpeg, png and webp are"
        )
    return jpeg(np.asarray(picture, np.uint8), quality)


def pixels(topic: str, message: Any, data: bytes) -> NDArray[np.uint8]:
    """Decode a raw picture to (H, W, 3) BGR or (H, W) grey; raises InterchangeError."""
    name = message.encoding.lower()
    if name not in _ENCODINGS:
        known = ", ".join(sorted(_ENCODINGS))
        raise InterchangeError(f"{topic}: pictures of {message.encoding!r}; supported are {known}")
    size, conversion = _ENCODINGS[name]
    height, width, step = int(message.height), int(message.width), int(message.step)
    if step < width * size or len(data) < step * height or not width * height:
        raise InterchangeError(
            f"{topic}: a picture of {width}x{height} {name} has {len(data)} bytes in rows of {step}"
        )
    rows = np.frombuffer(data, np.uint8, step * height).reshape(height, step)[:, : width * size]
    if name == "mono16":
        order = ">u2" if getattr(message, "is_bigendian", 0) else "<u2"
        return np.asarray(np.ascontiguousarray(rows).view(order) >> 8, np.uint8)
    shaped = rows if size == 1 else rows.reshape(height, width, size)
    shaped = np.ascontiguousarray(shaped)
    return shaped if conversion is None else np.asarray(cv2.cvtColor(shaped, conversion), np.uint8)
