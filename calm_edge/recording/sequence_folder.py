"""Read a drive stored as two folders of images and optional files of their time stamps.

Ground truth in the same folder (`calib.txt`, `poses0.txt`) is read by `evaluation` only.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.types import CalmEdgeError, Int
from device.frame import Eye, Frame

# added to every stamp, so that stamps from 0 s on are positive
ORIGIN_NS = 1_000_000_000
DEFAULT_RATE_HZ = 10.0

_SUFFIXES = {".png", ".jpg", ".jpeg"}
_PNG = b"\x89PNG\r\n\x1a\n"
# start-of-frame markers of JPEG; C4, C8 and CC in this range have other meanings
_JPEG_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}


class SequenceError(CalmEdgeError):
    """A sequence folder is incomplete or invalid."""


def image_size(path: Path) -> tuple[int, int]:
    """Read (width, height) in px from the header of a PNG or JPEG; raises SequenceError."""
    try:
        with path.open("rb") as file:
            head = file.read(24)
            if head.startswith(_PNG) and len(head) == 24:
                return int.from_bytes(head[16:20], "big"), int.from_bytes(head[20:24], "big")
            if head.startswith(b"\xff\xd8"):
                file.seek(2)
                while (mark := file.read(4)) and len(mark) == 4 and mark[0] == 0xFF:
                    if mark[1] == 0xFF:  # skip a fill byte before the marker
                        file.seek(-3, 1)
                        continue
                    if mark[1] in _JPEG_FRAME:
                        body = file.read(5)
                        if len(body) == 5:
                            height, width = body[1:3], body[3:5]
                            return int.from_bytes(width, "big"), int.from_bytes(height, "big")
                        break
                    file.seek(int.from_bytes(mark[2:4], "big") - 2, 1)
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror})") from None
    raise SequenceError(f"{path}: not a readable image; replace it or remove it from the folder")


def read_times(path: Path) -> Int:
    """Read stamps (N,) in ns from a file of seconds, one per line: round(s * 1e9) + ORIGIN_NS.

    Raises SequenceError if a line is not a number or the stamps do not increase.
    """
    stamps: list[int] = []
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise SequenceError(f"{path}: cannot be read ({error})") from None
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            t_ns = round(float(line) * 1e9) + ORIGIN_NS
        except (ValueError, OverflowError):
            raise SequenceError(f"{path}:{number}: {line!r} is not a time in seconds") from None
        if t_ns <= 0:
            raise SequenceError(
                f"{path}:{number}: {line.strip()} s: not after -1 s; add a constant to all times"
            )
        if stamps and t_ns <= stamps[-1]:
            raise SequenceError(
                f"{path}:{number}: {line.strip()} s is not after the line before; "
                "stamps must increase from line to line"
            )
        stamps.append(t_ns)
    return np.array(stamps, np.int64)


class SequenceFolder:
    """A folder with `cam0/ cam1/` (png or jpg, sorted by name), optional `times0.txt times1.txt`.

    Stamps are round(seconds * 1e9) + ORIGIN_NS; without time files both cameras run at 10 Hz.
    Opening checks the headers of all images; raises SequenceError.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        if not self.path.is_dir():
            raise SequenceError(f"{self.path}: no such folder; a sequence holds cam0/ and cam1/")
        self._files = (self._list(Eye.PRIMARY), self._list(Eye.ASSISTANT))
        self._size = (self._one_size(Eye.PRIMARY), self._one_size(Eye.ASSISTANT))
        self._t_ns = self._stamps()

    def count(self, eye: Eye) -> int:
        """Number of frames of an eye."""
        return len(self._files[eye])

    def size(self, eye: Eye) -> tuple[int, int]:
        """(width, height) in px of all images of an eye."""
        return self._size[eye]

    def t_ns(self, eye: Eye) -> Int:
        """Stamps (N,) in ns of an eye's frames."""
        return self._t_ns[eye].copy()

    def frames(self, eye: Eye) -> Iterator[Frame]:
        """Iterate over an eye's frames: a JPEG as its bytes, a PNG as (H, W, 3) BGR.

        Raises SequenceError at an image that cannot be read.
        """
        for i, file in enumerate(self._files[eye]):
            yield Frame(eye, i, int(self._t_ns[eye][i]), _read_image(file))

    def _list(self, eye: Eye) -> list[Path]:
        folder = self.path / f"cam{int(eye)}"
        if not folder.is_dir():
            raise SequenceError(f"{folder}: missing; calm-edge needs both cam0/ and cam1/")
        files = sorted(f for f in folder.iterdir() if f.suffix.lower() in _SUFFIXES)
        if not files:
            raise SequenceError(f"{folder}: holds no .png or .jpg; put this camera's images there")
        return files

    def _one_size(self, eye: Eye) -> tuple[int, int]:
        files = self._files[eye]
        first = image_size(files[0])
        for file in files[1:]:
            size = image_size(file)
            if size != first:
                raise SequenceError(
                    f"{file}: {size[0]}x{size[1]} px, but {files[0].name} has "
                    f"{first[0]}x{first[1]}; all images of a camera must have one size"
                )
        return first

    def _stamps(self) -> tuple[Int, Int]:
        paths = [self.path / f"times{int(eye)}.txt" for eye in Eye]
        there = [p.is_file() for p in paths]
        if any(there) and not all(there):
            missing = paths[there.index(False)]
            raise SequenceError(
                f"{missing}: missing; give times of both cameras, or of neither "
                f"(then {DEFAULT_RATE_HZ} Hz is assumed)"
            )
        stamps = []
        for eye, path in zip(Eye, paths, strict=True):
            n = self.count(eye)
            if not all(there):
                period = round(1e9 / DEFAULT_RATE_HZ)
                stamps.append(np.arange(n, dtype=np.int64) * period + ORIGIN_NS)
                continue
            t_ns = read_times(path)
            if len(t_ns) != n:
                raise SequenceError(
                    f"{path}: {len(t_ns)} times for {n} images in cam{int(eye)}/; "
                    "it must hold one line per image"
                )
            stamps.append(t_ns)
        return stamps[0], stamps[1]


def _read_image(path: Path) -> NDArray[np.uint8] | bytes:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise SequenceError(f"{path}: cannot be read ({error.strerror})") from None
    if data.startswith(b"\xff\xd8"):
        # decoders fill a truncated JPEG with grey, so check for its end marker
        if b"\xff\xd9" in data[-4096:]:
            return data
    elif b"IEND" in data[-64:]:
        import cv2

        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        if image is not None:
            return np.asarray(image, np.uint8)
    raise SequenceError(f"{path}: truncated or damaged; replace it or remove it from the folder")
