"""A timestamped image of a camera driver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from device import jpeg_pixels
from device.jpeg import JpegError, walk


class Eye(IntEnum):
    """The two cameras: the trajectory is the primary's, the assistant gives the scale."""

    PRIMARY = 0
    ASSISTANT = 1


# quality of the JPEG encoding of images that a camera delivers uncompressed
JPEG_QUALITY = 92

_PNG = b"\x89PNG\r\n\x1a\n"
_GRAY = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}


class UnreadableImage(ValueError):
    """The bytes of a frame are not a whole picture."""


@dataclass(frozen=True, slots=True)
class Unusable:
    """A stored frame without a usable image. reason: names the file and what is wrong with it."""

    eye: Eye
    sequence: int
    reason: str


def jpeg(image: NDArray[np.uint8], quality: int = JPEG_QUALITY) -> bytes:
    """Encode (H, W, 3) BGR or (H, W) grey pixels as JPEG. quality: 1 to 100."""
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


@dataclass(frozen=True, slots=True)
class Frame:
    """One image of one camera.

    sequence: the driver's frame counter; a gap is a dropped frame.
    t_ns: host-monotonic nanoseconds; the time of exposure if the driver provides it.
    image: (H, W, 3) uint8 BGR, or a JPEG, from SOI to EOI as the camera sent it. own_stamp: False
    if t_ns is not measured but made up from the order of the frames.
    """

    eye: Eye
    sequence: int
    t_ns: int
    image: NDArray[np.uint8] | bytes
    own_stamp: bool = True

    def encoded(self, quality: int = JPEG_QUALITY) -> Frame:
        """Return the frame with JPEG bytes: those of the camera, else encoded from the pixels."""
        if isinstance(self.image, bytes):
            return self
        return replace(self, image=jpeg(self.image, quality))

    def size(self) -> tuple[int, int]:
        """(width, height) px as decoded, from the header of a JPEG; raises UnreadableImage."""
        if isinstance(self.image, bytes) and not self.image.startswith(_PNG):
            try:
                return walk(self.image).size
            except JpegError as error:
                raise self._unreadable(str(error)) from None
        height, width = self.bgr().shape[:2]
        return int(width), int(height)

    def bgr(self) -> NDArray[np.uint8]:
        """Decode to (H, W, 3) uint8 BGR; raises UnreadableImage.

        A JPEG that is not whole raises, and is turned as its EXIF orientation says.
        """
        if isinstance(self.image, bytes):
            return self._decoded(gray=False, reduction=1)
        return self.image

    def gray(self, reduction: int = 1) -> NDArray[np.uint8]:
        """Decode to (H, W) uint8 grey, at 1 / `reduction` (1, 2 or 8) of the size; as `bgr`.

        A JPEG is decoded at the reduced size, which is cheaper.
        """
        if isinstance(self.image, bytes):
            return self._decoded(gray=True, reduction=reduction)
        gray = np.asarray(cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY), np.uint8)
        if reduction == 1:
            return gray
        size = (-(-gray.shape[1] // reduction), -(-gray.shape[0] // reduction))
        return np.asarray(cv2.resize(gray, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _decoded(self, *, gray: bool, reduction: int) -> NDArray[np.uint8]:
        assert isinstance(self.image, bytes)
        if self.image.startswith(_PNG):
            flag = _GRAY[reduction] if gray else cv2.IMREAD_COLOR
            pixels = cv2.imdecode(np.frombuffer(self.image, np.uint8), flag)
            if pixels is not None:
                return np.asarray(pixels, np.uint8)
            reason = "damaged PNG"
        else:
            try:
                return jpeg_pixels.decode(walk(self.image), gray=gray, reduction=reduction)
            except JpegError as error:
                reason = str(error)
        raise self._unreadable(reason)

    def _unreadable(self, reason: str) -> UnreadableImage:
        return UnreadableImage(f"{self.eye.name.lower()} frame {self.sequence}: {reason}")
