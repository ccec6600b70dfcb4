"""Decode V4L2 buffers: JPEG stays encoded, other pixel formats become BGR by OpenCV."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from device.drivers.v4l2_ioctl import PixelFormat
from device.jpeg import completed

JPEGS = ("MJPG", "JPEG")
# fourcc -> OpenCV's conversion code to BGR; None: it is BGR already
_PAIRS = {
    "YUYV": cv2.COLOR_YUV2BGR_YUYV,
    "UYVY": cv2.COLOR_YUV2BGR_UYVY,
    "YVYU": cv2.COLOR_YUV2BGR_YVYU,
}
_SEMI_PLANAR = {"NV12": cv2.COLOR_YUV2BGR_NV12, "NV21": cv2.COLOR_YUV2BGR_NV21}
_PLANAR = {"YU12": cv2.COLOR_YUV2BGR_I420, "YV12": cv2.COLOR_YUV2BGR_YV12}
_TRIPLES = {"BGR3": None, "RGB3": cv2.COLOR_RGB2BGR}
_GRAYS = {"GREY": cv2.COLOR_GRAY2BGR}
# accepted formats by preference: JPEG needs least USB bandwidth and is recorded without re-encoding
WANTED = (*JPEGS, *_PAIRS, *_SEMI_PLANAR, *_PLANAR, *_TRIPLES, *_GRAYS)


def decode(data: bytes, form: PixelFormat) -> NDArray[np.uint8] | bytes | None:
    """Return a complete JPEG, or (H, W, 3) uint8 BGR; None for an invalid buffer."""
    if form.fourcc in JPEGS:
        return completed(data)
    width, height = form.width_px, form.height_px
    if form.fourcc in _PAIRS:
        rows = _rows(data, height, 2 * width, form.stride_bytes)
        return None if rows is None else _bgr(rows.reshape(height, width, 2), _PAIRS[form.fourcc])
    if form.fourcc in _SEMI_PLANAR:
        rows = _rows(data, height * 3 // 2, width, form.stride_bytes)
        return None if rows is None else _bgr(rows, _SEMI_PLANAR[form.fourcc])
    if form.fourcc in _PLANAR:
        return _planar(data, form)
    if form.fourcc in _TRIPLES:
        rows = _rows(data, height, 3 * width, form.stride_bytes)
        return None if rows is None else _bgr(rows.reshape(height, width, 3), _TRIPLES[form.fourcc])
    rows = _rows(data, height, width, form.stride_bytes)
    return None if rows is None else _bgr(rows, _GRAYS[form.fourcc])


def _rows(
    data: bytes, n: int, length: int, stride: int, start: int = 0
) -> NDArray[np.uint8] | None:
    """Extract (n, length) bytes from rows `stride` bytes apart; None if data is too short."""
    stride = stride or length
    if stride < length or len(data) < start + stride * n:
        return None
    padded = np.frombuffer(data, np.uint8, stride * n, start).reshape(n, stride)
    return np.ascontiguousarray(padded[:, :length])


def _planar(data: bytes, form: PixelFormat) -> NDArray[np.uint8] | None:
    """Decode a planar format, whose two chroma planes have half the size and stride."""
    width, height = form.width_px, form.height_px
    stride = form.stride_bytes or width
    luma = _rows(data, height, width, stride)
    chroma = _rows(data, height, width // 2, stride // 2, start=stride * height)
    if luma is None or chroma is None:
        return None
    packed = np.concatenate([luma, chroma.reshape(height // 2, width)])
    return _bgr(packed, _PLANAR[form.fourcc])


def _bgr(pixels: NDArray[np.uint8], conversion: int | None) -> NDArray[np.uint8]:
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)
