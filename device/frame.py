"""A timestamped image of a camera driver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import cv2
import numpy as np
from numpy.typing import NDArray


class Eye(IntEnum):
    """The two cameras: the trajectory is the primary's, the assistant gives the scale."""

    PRIMARY = 0
    ASSISTANT = 1


# quality of the JPEG encoding of images that a camera delivers uncompressed
JPEG_QUALITY = 92

_GRAY = {
    1: cv2.IMREAD_GRAYSCALE,
    2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
    8: cv2.IMREAD_REDUCED_GRAYSCALE_8,
}


class UnreadableImage(ValueError):
    """OpenCV cannot decode the bytes of a frame."""


def jpeg(image: NDArray[np.uint8], quality: int = JPEG_QUALITY) -> bytes:
    """Encode (H, W, 3) BGR or (H, W) grey pixels as JPEG. quality: 1 to 100."""
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


@dataclass(frozen=True, slots=True)
class Frame:
    """One image of one camera.

    sequence: the driver's frame counter; a gap is a dropped frame.
    t_ns: host-monotonic nanoseconds; the time of exposure if the driver provides it.
    image: (H, W, 3) uint8 BGR, or JPEG bytes exactly as the camera sent them.
    """

    eye: Eye
    sequence: int
    t_ns: int
    image: NDArray[np.uint8] | bytes

    def encoded(self, quality: int = JPEG_QUALITY) -> Frame:
        """Return the frame with JPEG bytes: those of the camera, else encoded from the pixels."""
        if isinstance(self.image, bytes):
            return self
        return replace(self, image=jpeg(self.image, quality))

    def bgr(self) -> NDArray[np.uint8]:
        """Decode to (H, W, 3) uint8 BGR; raises UnreadableImage."""
        return self._decode(cv2.IMREAD_COLOR)

    def gray(self, reduction: int = 1) -> NDArray[np.uint8]:
        """Decode to (H, W) uint8 grey, at 1 / `reduction` (1, 2 or 8) of the size; raises
        UnreadableImage. A JPEG is decoded at the reduced size, which is cheaper.
        """
        decoded = self._decode(_GRAY[reduction if isinstance(self.image, bytes) else 1])
        if isinstance(self.image, bytes) or reduction == 1:
            return decoded
        size = (-(-decoded.shape[1] // reduction), -(-decoded.shape[0] // reduction))
        return np.asarray(cv2.resize(decoded, size, interpolation=cv2.INTER_AREA), np.uint8)

    def _decode(self, flag: int) -> NDArray[np.uint8]:
        if isinstance(self.image, bytes):
            decoded = cv2.imdecode(np.frombuffer(self.image, np.uint8), flag)
            if decoded is None:
                raise UnreadableImage(
                    f"{self.eye.name.lower()} frame {self.sequence}: not a readable image"
                )
            return np.asarray(decoded, np.uint8)
        if flag == cv2.IMREAD_GRAYSCALE:
            return np.asarray(cv2.cvtColor(self.image, cv2.COLOR_BGR2GRAY), np.uint8)
        return self.image
