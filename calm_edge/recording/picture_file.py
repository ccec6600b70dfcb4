"""Read the picture files of one camera: JPEG as bytes, made complete, others as 8-bit pixels."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.recording import SequenceError
from device.jpeg import SOI, Jpeg, JpegError, walk, with_orientation

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm"})
# so many files are tried for a readable first one
_TRIED = 100
# pictures from which the number of used bits is found
_SAMPLES = 12
_DEPTHS = (8, 10, 12, 14, 16)
_PNG, _PNG_END, _BMP = b"\x89PNG\r\n\x1a\n", b"IEND", b"BM"
# how other pictures begin, whatever their names are: PNG, WebP, TIFF
_OTHERS = (_PNG, b"RIFF", b"II*\0", b"MM\0*")
_POINTER, _LFS = b"version https://git-lfs", "a pointer of Git LFS (git lfs pull gets the picture)"
_TURNS = ("", "mirrored", "by 180 degrees", "by 180 degrees and mirrored",
          "by 90 degrees and mirrored", "by 90 degrees clockwise",
          "by 270 degrees and mirrored", "by 90 degrees anticlockwise")  # fmt: skip

log = logging.getLogger(__name__)


class PictureError(SequenceError):
    """A file is not a readable picture."""


class PictureFiles:
    """Reader of the picture files of one camera.

    EXIF's orientation is that of the first picture for all: the camera is fixed to the car, and a
    telephone that is shaken changes its mind. Of 16 bits as many count as a sample of the pictures
    uses. size: (width, height) px of the first readable one, decoded. notes: lines for the user.
    Opening raises PictureError if none of the first files is readable.
    """

    def __init__(self, files: Sequence[Path]) -> None:
        self.notes: list[str] = []
        self._orientation: int | None = None
        self._warned = False
        self._bits = 16
        self.size = self._examine(files)

    def read(self, file: Path) -> NDArray[np.uint8] | bytes:
        """Return a JPEG's bytes from SOI to EOI, else pixels (H, W, 3) BGR; raises PictureError.

        That a JPEG lacks a part of the picture is found when it is decoded.
        """
        data = _bytes(file)
        named = file.suffix.lower() in (".jpg", ".jpeg") and not data.startswith(_OTHERS)
        if data.startswith(SOI) or named:
            try:
                return self._turned_as_first(file, walk(data)).data
            except JpegError as error:
                reason = "empty" if not data else _LFS if data.startswith(_POINTER) else error
                raise PictureError(f"{file}: {reason}") from None
        pixels = _pixels(file, data)
        if pixels.dtype == np.uint16:
            pixels = np.minimum(pixels >> (self._bits - 8), 255).astype(np.uint8)
        return np.asarray(pixels, np.uint8)

    def _examine(self, files: Sequence[Path]) -> tuple[int, int]:
        failure: PictureError | None = None
        for file in files[:_TRIED]:
            try:
                picture = self.read(file)
                if isinstance(picture, bytes):
                    return walk(picture).size
                if _pixels(file, _bytes(file)).dtype == np.uint16:
                    self._count_bits(files)
                return picture.shape[1], picture.shape[0]
            except PictureError as error:
                failure = failure or error
        assert failure is not None
        tried = f"none of the {len(files[:_TRIED])} first files of this folder is readable"
        raise PictureError(f"{failure}; {tried}: copy them again, or convert them to JPEG or PNG")

    def _count_bits(self, files: Sequence[Path]) -> None:
        brightest = 0
        for file in files[:: -(-len(files) // _SAMPLES)]:
            try:
                brightest = max(brightest, int(_pixels(file, _bytes(file)).max()))
            except PictureError:
                continue
        self._bits = next(bits for bits in _DEPTHS if brightest < 1 << bits)
        if self._bits < 16:
            self.notes.append(f"{files[0].parent}: the pictures use {self._bits} of 16 bits")

    def _turned_as_first(self, file: Path, jpeg: Jpeg) -> Jpeg:
        if self._orientation is None:
            self._orientation = jpeg.orientation
            if jpeg.orientation != 1:
                turn = _TURNS[jpeg.orientation - 1]
                self.notes.append(f"{file.parent}: turned {turn}, as EXIF says in {file.name}")
        if jpeg.orientation != self._orientation and not self._warned:
            self._warned = True
            log.warning(
                "%s: EXIF says that the camera was turned within the drive; ignored, as it is "
                "fixed to the car",
                file,
            )
        return with_orientation(jpeg, self._orientation)


def _bytes(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError as error:
        raise PictureError(f"{file}: cannot be read ({error.strerror})") from None


def _pixels(file: Path, data: bytes) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Decode to (H, W, 3) BGR of 8 or 16 bits; raises PictureError."""
    cut = data.startswith(_PNG) and _PNG_END not in data[-64:]
    cut |= data.startswith(_BMP) and int.from_bytes(data[2:6], "little") > len(data)
    if cut or not data:
        raise PictureError(f"{file}: truncated")
    # OpenCV would print what its libraries say of a damaged file
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    except cv2.error:
        image = None
    finally:
        cv2.utils.logging.setLogLevel(before)
    if image is None:
        raise PictureError(f"{file}: not a readable picture")
    if image.dtype not in (np.uint8, np.uint16):
        raise PictureError(f"{file}: pixels of {image.dtype}; convert them to 8 or 16 bits")
    return image  # type: ignore[return-value]
