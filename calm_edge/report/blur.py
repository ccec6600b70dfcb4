"""Make faces and number plates in pictures unreadable, as far as OpenCV's detectors find them.

Best effort: a detector misses some, above all small, turned or dark ones, and plates other than
those it was trained on.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from calm_edge.types import Bytes, CalmEdgeError

# Haar cascades as released with OpenCV; whether the picture is searched mirrored, too
CASCADES = {
    "haarcascade_frontalface_default.xml": False,
    "haarcascade_profileface.xml": True,
    "haarcascade_russian_plate_number.xml": False,
}
# of the Debian package opencv-data, and of other builds of OpenCV
FOLDERS = (Path("/usr/share/opencv4/haarcascades"), Path("/usr/share/opencv/haarcascades"))
# pictures are searched at this width
WIDTH_PX = 960
# share by which a found place is enlarged on each side, and the blocks that are left of it
MARGIN, BLOCKS = 0.2, 4


class BlurError(CalmEdgeError):
    """The detectors are not on this computer."""


class Blur:
    """Finder of faces and plates; call it with a picture.

    pictures, places: how many were searched and found so far.
    """

    def __init__(self, folder: Path | None = None) -> None:
        """folder: with the cascades; None: where OpenCV's packages have them. Raises BlurError."""
        folders = FOLDERS if folder is None else (folder,)
        found = next((f for f in folders if all((f / name).is_file() for name in CASCADES)), None)
        if found is None:
            where = " and ".join(map(str, folders))
            raise BlurError(
                f"--blur: {', '.join(CASCADES)} are not in {where}; apt install opencv-data, or "
                "give their folder with --blur-models, or use --no-pictures"
            )
        try:
            self._cascades = [
                (cv2.CascadeClassifier(str(found / name)), mirrored)
                for name, mirrored in CASCADES.items()
            ]
            readable = not any(cascade.empty() for cascade, _ in self._cascades)
        except (cv2.error, SystemError):
            readable = False
        if not readable:
            raise BlurError(f"--blur: {found}: a cascade cannot be read; install opencv-data again")
        self.pictures = self.places = 0

    def __call__(self, image: Bytes) -> Bytes:
        """A copy of a picture (H, W, 3) in which places found are coarse blocks."""
        out = image.copy()
        self.pictures += 1
        for x, y, width, height in self._found(image):
            self.places += 1
            more = round(MARGIN * width), round(MARGIN * height)
            rows = slice(max(y - more[1], 0), y + height + more[1])
            columns = slice(max(x - more[0], 0), x + width + more[0])
            part = out[rows, columns]
            coarse = cv2.resize(part, (BLOCKS, BLOCKS), interpolation=cv2.INTER_AREA)
            size = part.shape[1], part.shape[0]
            out[rows, columns] = cv2.resize(coarse, size, interpolation=cv2.INTER_NEAREST)
        return out

    def __str__(self) -> str:
        return (
            f"{self.places} places in {self.pictures} pictures are made unreadable: best effort, "
            "look through them before you share the map"
        )

    def _found(self, image: Bytes) -> Iterator[tuple[int, int, int, int]]:
        """Boxes x, y, width, height [px] of the picture."""
        scale = WIDTH_PX / image.shape[1]
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
        size = WIDTH_PX, round(scale * image.shape[0])
        small = cv2.equalizeHist(cv2.resize(gray, size, interpolation=cv2.INTER_LINEAR))
        for cascade, mirrored in self._cascades:
            for flipped in (False, True)[: 1 + mirrored]:
                searched = small[:, ::-1] if flipped else small
                boxes = cascade.detectMultiScale(np.ascontiguousarray(searched), 1.1, 3)
                for x, y, width, height in np.reshape(boxes, (-1, 4)).tolist():
                    left = size[0] - x - width if flipped else x
                    low = int(left / scale), int(y / scale)
                    yield *low, int(np.ceil(width / scale)), int(np.ceil(height / scale))
