"""Decode a JPEG to pixels, if it is whole: an incomplete one would be filled up with grey."""

from __future__ import annotations

import re

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from device.jpeg import EOI, Jpeg, JpegError

# libjpeg's warnings that mean lost pixels; it has others, e.g. of unknown colour transforms
_DAMAGE = ("Corrupt JPEG data", "Premature end")
_EXTRANEOUS = re.compile(r"(\d+) extraneous bytes before marker 0xd9")
# so many bytes between the last scan and EOI come from aligning a buffer
_ALIGNMENT_BYTES = 4
_TRANSPOSED = 5
# EXIF orientation -> flip code of OpenCV, for 5 to 8 after transposing
_FLIPS = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}
_OPENCV = {1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 8: cv2.IMREAD_REDUCED_COLOR_8}


def decode(jpeg: Jpeg, *, gray: bool = False, reduction: int = 1) -> NDArray[np.uint8]:
    """Decode to (H, W, 3) BGR or (H, W) grey, turned as its orientation says.

    reduction: 1, 2 or 8: decode at 1 / reduction of the size, rounded up. Raises JpegError if a
    part of the picture is missing or damaged.
    """
    if jpeg.torn:
        raise JpegError("damaged JPEG")
    try:
        pixels = _decoded(jpeg, gray, reduction, strict=True)
    except ValueError as error:
        if _is_damage(str(error), jpeg.data):
            raise JpegError(f"incomplete or damaged JPEG ({error})") from None
        pixels = _with_warnings(jpeg, gray, reduction)
    return turned(pixels, jpeg.orientation)


def turned(pixels: NDArray[np.uint8], orientation: int) -> NDArray[np.uint8]:
    """Turn stored pixels (H, W) or (H, W, 3) upright, by their EXIF orientation 1 to 8."""
    if orientation >= _TRANSPOSED:
        pixels = np.asarray(cv2.transpose(pixels), np.uint8)
    if orientation in _FLIPS:
        pixels = np.asarray(cv2.flip(pixels, _FLIPS[orientation]), np.uint8)
    return pixels


def _decoded(jpeg: Jpeg, gray: bool, reduction: int, *, strict: bool) -> NDArray[np.uint8]:
    pixels = simplejpeg.decode_jpeg(
        jpeg.data,
        "GRAY" if gray else "BGR",
        min_height=-(-jpeg.height_px // reduction),
        min_width=-(-jpeg.width_px // reduction),
        strict=strict,
    )
    return np.asarray(pixels[:, :, 0] if gray else pixels, np.uint8)


def _with_warnings(jpeg: Jpeg, gray: bool, reduction: int) -> NDArray[np.uint8]:
    """Decode what libjpeg warns of without need, or in a layout that simplejpeg does not take."""
    try:
        return _decoded(jpeg, gray, reduction, strict=False)
    except ValueError:
        flag = _OPENCV[reduction] | cv2.IMREAD_IGNORE_ORIENTATION
        pixels = cv2.imdecode(np.frombuffer(jpeg.data, np.uint8), flag)
    if pixels is None:
        raise JpegError("damaged JPEG, or of a kind that is not supported")
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY) if gray else pixels, np.uint8)


def _is_damage(warning: str, data: bytes) -> bool:
    if not warning.startswith(_DAMAGE):
        return False
    found = _EXTRANEOUS.search(warning)
    if found is None:
        return True
    # cameras align their buffers before EOI, or fill them with one byte
    count = int(found[1])
    padding = data[: -len(EOI)][-count:] if count else b""
    return (
        count > _ALIGNMENT_BYTES and padding.strip(b"\0") != b"" and padding.strip(b"\xff") != b""
    )
