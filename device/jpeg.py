"""Walk the markers of a JPEG: cut it out, complete it, read its size and orientation.

ITU-T T.81: markers in table B.1, the Huffman tables that Motion JPEG leaves out in annex K.3.
"""

from __future__ import annotations

import dataclasses
import re
import struct
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

SOI, EOI = b"\xff\xd8", b"\xff\xd9"
_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# frames coded with Huffman tables; the other ones are arithmetic or lossless
_HUFFMAN = frozenset({0xC0, 0xC1, 0xC2})
_DHT, _SOI, _EOI, _SOS, _APP1 = 0xC4, 0xD8, 0xD9, 0xDA, 0xE1
# markers without a length: RST0 to RST7, SOI, EOI and TEM
_ALONE = frozenset({*range(0xD0, 0xDA), 0x01})
# what may follow the data of a scan: DHT, SOI, EOI, SOS, DQT, DNL, DRI, COM, APP0 to APP15
_AFTER_SCAN = frozenset({_DHT, _SOI, _EOI, _SOS, 0xDB, 0xDC, 0xDD, 0xFE, *range(0xE0, 0xF0)})
# in the data of a scan FF 00 is a byte, FF D0 to FF D7 are restart markers, FF FF is fill
_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
# Some cameras send their whole buffer, filled up with zeros; so many may be data of the scan.
_KEPT_ZEROS = 64
_EXIF = b"Exif\x00\x00"
_ORIENTATION_TAG = 0x0112


class JpegError(ValueError):
    """Bytes are not a JPEG, or one that is incomplete or damaged."""


@dataclass(frozen=True, slots=True)
class Jpeg:
    """A JPEG from SOI to EOI with Huffman tables, and what its markers say.

    width_px, height_px: of the stored pixels. orientation: EXIF's, 1 to 8; 1 without EXIF.
    orientation_at: offset of its low byte in `data`, -1 without EXIF. torn: markers stand where
    none can, so the data is damaged.
    """

    data: bytes
    width_px: int
    height_px: int
    orientation: int = 1
    orientation_at: int = -1
    torn: bool = False

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) px when decoded, i.e. turned by the orientation."""
        if self.orientation >= 5:
            return self.height_px, self.width_px
        return self.width_px, self.height_px


def walk(data: bytes) -> Jpeg:
    """Find the first JPEG in `data`; raises JpegError if there is none.

    What precedes SOI and follows EOI is dropped; a missing EOI and missing Huffman tables are
    added. If another SOI comes before EOI, the picture was cut, and the next one is taken.
    """
    at = 0
    while (start := data.find(SOI + b"\xff", at)) >= 0:
        jpeg, at = _walk_from(data, start)
        if jpeg is not None:
            return jpeg
    raise JpegError("not a JPEG")


def completed(data: bytes) -> bytes | None:
    """Return the bytes of the first JPEG in `data` as of `walk`; None if there is none."""
    try:
        return walk(data).data
    except JpegError:
        return None


def _walk_from(data: bytes, start: int) -> tuple[Jpeg | None, int]:
    """Walk the JPEG whose SOI is at `start`, until EOI or another SOI.

    Returns it, None if it has no scan, and where the walk ended: a thumbnail in a segment before
    is not another picture.
    """
    size: tuple[int, int] | None = None
    orientation, orientation_at = 1, -1
    huffman, tables, torn = False, False, False
    first_scan, at, end = -1, start + 2, len(data)
    while at + 1 < len(data):
        marker = data[at + 1]
        if data[at] != 0xFF or marker == _SOI or (marker == _EOI and first_scan < 0):
            return None, max(at, start + 2)
        if marker == _EOI:
            end = at
            break
        if marker == 0xFF or marker in _ALONE:
            at += 1 if marker == 0xFF else 2
            continue
        body, after = _segment(data, at)
        if body is None:
            end, torn = at, True
            break
        if marker in _SOF and len(body) >= 5:
            height, width = struct.unpack_from(">HH", body, 1)
            size, huffman = (width, height), marker in _HUFFMAN
        elif marker == _DHT:
            tables = True
        elif marker == _APP1 and orientation_at < 0:
            orientation, low = _exif_orientation(body)
            orientation_at = at + 4 + low - start if low >= 0 else -1
        elif marker == _SOS:
            first_scan = at if first_scan < 0 else first_scan
            after, impossible = _end_of_scan(data, after)
            torn |= impossible
            end = after
        at = after
    if size is None or first_scan < 0 or min(size) < 1:
        return None, max(at, start + 2)
    missing = _standard_tables() if huffman and not tables else b""
    picture = data[start:first_scan] + missing + data[first_scan:end]
    zeros = len(picture) - len(picture.rstrip(b"\0"))
    picture = picture[: len(picture) - max(0, zeros - _KEPT_ZEROS)]
    return Jpeg(picture + EOI, *size, orientation, orientation_at, torn), end


def _segment(data: bytes, at: int) -> tuple[bytes | None, int]:
    """Body of the segment whose marker is at `at`, None if it is cut; and where it ends."""
    length = int.from_bytes(data[at + 2 : at + 4], "big")
    body = data[at + 4 : at + 2 + length]
    return (body if len(body) == length - 2 else None), at + 2 + length


def _end_of_scan(data: bytes, at: int) -> tuple[int, bool]:
    """Offset of the marker that ends the scan at `at`, and whether impossible ones precede it."""
    impossible = False
    for found in _MARKER.finditer(data, at):
        if data[found.start() + 1] in _AFTER_SCAN:
            return found.start(), impossible
        impossible = True
    # half a marker at the end is not data
    return len(data) - data.endswith(b"\xff"), impossible


@cache
def _standard_tables() -> bytes:
    """DHT segments of annex K.3: those of any encoder that does not optimise its tables."""
    options = [cv2.IMWRITE_JPEG_OPTIMIZE, 0]
    data = bytes(cv2.imencode(".jpg", np.zeros((16, 16, 3), np.uint8), options)[1])
    at, tables = 2, b""
    while (marker := data[at + 1]) != _SOS:
        after = _segment(data, at)[1]
        tables += data[at:after] if marker == _DHT else b""
        at = after
    return tables


def _exif_orientation(body: bytes) -> tuple[int, int]:
    """Orientation in an APP1 segment, and the offset of its low byte; (1, -1) without one."""
    tiff = body.removeprefix(_EXIF)
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None or not body.startswith(_EXIF):
        return 1, -1
    try:
        (directory,) = struct.unpack_from(order + "I", tiff, 4)
        (count,) = struct.unpack_from(order + "H", tiff, directory)
        for entry in range(directory + 2, directory + 2 + 12 * count, 12):
            tag, kind = struct.unpack_from(order + "HH", tiff, entry)
            if (tag, kind) == (_ORIENTATION_TAG, 3):
                (value,) = struct.unpack_from(order + "H", tiff, entry + 8)
                low = len(_EXIF) + entry + 8 + (order == ">")
                return (value if 1 <= value <= 8 else 1), low
    except struct.error:
        pass
    return 1, -1


def with_orientation(jpeg: Jpeg, orientation: int) -> Jpeg:
    """Write another EXIF orientation, 1 to 8, into a JPEG; the stored pixels are unchanged."""
    if orientation == jpeg.orientation:
        return jpeg
    data, low = jpeg.data, jpeg.orientation_at
    if low < 0:
        # big endian, one entry: a SHORT, left-aligned in its four bytes
        tiff = b"MM\0*" + struct.pack(">IHHHIHHI", 8, 1, _ORIENTATION_TAG, 3, 1, 0, 0, 0)
        segment = struct.pack(">BBH", 0xFF, _APP1, 2 + len(_EXIF) + len(tiff)) + _EXIF + tiff
        data = SOI + segment + data[2:]
        low = 2 + 4 + _exif_orientation(_EXIF + tiff)[1]
    data = data[:low] + bytes([orientation]) + data[low + 1 :]
    return dataclasses.replace(jpeg, data=data, orientation=orientation, orientation_at=low)
