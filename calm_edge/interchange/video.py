"""Read the pictures of a video, or of the parts it is split in, with their own stamps.

PyAV (FFmpeg's libraries) decodes; it is the extra `import`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.interchange import InterchangeError

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

SUFFIXES = frozenset({".mp4", ".m4v", ".mov", ".mkv", ".avi", ".ts", ".mts", ".m2ts", ".webm"})
# a stamp farther ahead than this is a fault of the file
LONGEST_GAP_S = 600.0
_ROTATIONS = {
    90: cv2.ROTATE_90_CLOCKWISE,
    180: cv2.ROTATE_180,
    270: cv2.ROTATE_90_COUNTERCLOCKWISE,
}


def require_av() -> Any:
    """Import PyAV; raises InterchangeError with the remedy if it is missing."""
    try:
        import av
    except ImportError:
        raise InterchangeError(
            "av: not installed; videos need it (pip install 'calm-edge[import]', or pip install av)"
        ) from None
    return av


def parts(source: Path) -> tuple[Path, ...]:
    """Files of a video: itself, or all videos in a folder in the order of their numbers.

    Raises InterchangeError if there is none.
    """
    if source.is_file():
        return (source,)
    if not source.is_dir():
        raise InterchangeError(f"{source}: no such file; give a video or a folder of its parts")
    found = [p for p in source.iterdir() if p.suffix.lower() in SUFFIXES and p.is_file()]
    if not found:
        raise InterchangeError(f"{source}: holds no video; give a folder with one camera's parts")
    return tuple(sorted(found, key=lambda p: natural(p.name)))


def natural(name: str) -> list[tuple[int, str]]:
    """Sort key by which part 9 is before part 10."""
    return [(int(w), "") if w.isdigit() else (-1, w) for w in re.findall(r"\d+|\D+", name)]


def rotated(picture: NDArray[np.uint8], clockwise_deg: int) -> NDArray[np.uint8]:
    """Rotate a picture by a multiple of 90 degrees."""
    code = _ROTATIONS.get(clockwise_deg % 360)
    return picture if code is None else np.asarray(cv2.rotate(picture, code), np.uint8)


@dataclass(slots=True)
class VideoReport:
    """What was found while reading: of the file's own figures, and of faults."""

    codec: str = ""
    size: tuple[int, int] = (0, 0)
    turned_deg: int = 0
    first_s: float = 0.0
    joins_s: list[float] = field(default_factory=list)
    repeated: int = 0
    broken: int = 0
    notes: list[str] = field(default_factory=list)
    ended: str = ""


class Video:
    """Pictures of a video in the order of display, decoded once; raises InterchangeError.

    turn_deg: clockwise rotation instead of that in the file. Stamps are seconds from the first
    picture; a part begins one median interval after the last picture of the part before.
    """

    def __init__(self, files: tuple[Path, ...], turn_deg: int | None = None) -> None:
        self.files = files
        self._turn = turn_deg
        self.report = VideoReport()

    def pictures(self) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Yield stamps [s] and pictures (H, W, 3) BGR, upright as the file says."""
        last = -1.0
        interval = 0.0
        for number, file in enumerate(self.files):
            start = last + interval if number else 0.0
            if number:
                self.report.joins_s.append(start)
            first: float | None = None
            steps: list[float] = []
            for stamp, picture in self._file(file):
                if first is None:
                    first = stamp
                    if not number:
                        self.report.first_s = stamp
                t = start + stamp - first
                if t <= last:
                    self.report.repeated += 1
                    continue
                if last >= 0 and t - last > LONGEST_GAP_S:
                    raise InterchangeError(
                        f"{file}: the stamps jump by {t - last:.0f} s at {last:.1f} s; "
                        "remux it (ffmpeg -i IN -c copy OUT), or cut it there"
                    )
                if last >= start and len(steps) < 1000:
                    steps.append(t - last)
                last = t
                yield t, picture
            if first is None:
                raise InterchangeError(f"{file}: holds no picture that can be decoded; repair it")
            interval = float(np.median(steps)) if steps else interval
        if last <= 0:
            raise InterchangeError(f"{self.files[0]}: holds one picture; give a video of a drive")

    def _file(self, file: Path) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        av = require_av()
        try:
            with av.open(str(file)) as container:
                yield from self._decoded(file, container)
        except av.error.FFmpegError as error:
            raise InterchangeError(
                f"{file}: cannot be read as a video ({error.strerror}); "
                "repair it, or give the files of a finished recording"
            ) from None

    def _decoded(
        self, file: Path, container: InputContainer
    ) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        av = require_av()
        stream = _stream(file, container)
        self.report.codec = stream.codec_context.name
        ratio = stream.sample_aspect_ratio
        seen = 0
        packets = container.demux(stream)
        while True:
            try:
                packet = next(packets, None)
            except av.error.FFmpegError as error:
                self.report.ended = f"{file}: ends in a damaged part ({error.strerror})"
                return
            if packet is None:
                return
            try:
                frames = packet.decode()
            except av.error.FFmpegError:
                self.report.broken += 1
                continue
            for frame in frames:
                if frame.pts is None or frame.time_base is None:
                    self.report.broken += 1
                    continue
                if frame.is_corrupt:
                    self.report.broken += 1
                    continue
                if not seen:
                    self._describe(file, frame, ratio)
                seen += 1
                yield float(frame.pts * frame.time_base), self._upright(file, frame, ratio)

    def _describe(self, file: Path, frame: VideoFrame, ratio: Any) -> None:
        report = self.report
        turn = (-round(frame.rotation / 90) * 90) % 360 if self._turn is None else self._turn % 360
        if report.size != (0, 0) and turn != report.turned_deg:
            raise InterchangeError(
                f"{file}: is rotated by {turn} degrees, the part before by {report.turned_deg}; "
                "import them apart, or give --rotate"
            )
        report.turned_deg = turn
        notes = []
        if frame.interlaced_frame:
            notes.append("interlaced: both fields are taken as one exposure")
        if ratio and ratio != 1:
            notes.append(f"pixels {float(ratio):.4g} times as wide as high: resampled to square")
        report.notes += [note for note in notes if note not in report.notes]

    def _upright(self, file: Path, frame: VideoFrame, ratio: Any) -> NDArray[np.uint8]:
        picture = np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
        if ratio and ratio != 1:
            size = max(1, round(picture.shape[1] * float(ratio))), picture.shape[0]
            picture = np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)
        picture = rotated(picture, self.report.turned_deg)
        size = (picture.shape[1], picture.shape[0])
        if self.report.size not in ((0, 0), size):
            raise InterchangeError(
                f"{file}: pictures of {size[0]}x{size[1]} after {self.report.size[0]}x"
                f"{self.report.size[1]} px; all pictures of a camera must have one size"
            )
        self.report.size = size
        return picture


def _stream(file: Path, container: InputContainer) -> VideoStream:
    streams = [s for s in container.streams.video if s.codec_context.name not in ("png", "bmp")]
    if not streams:
        raise InterchangeError(f"{file}: holds no video stream; give a video")
    stream = max(streams, key=lambda s: s.codec_context.width * s.codec_context.height)
    stream.thread_type = "AUTO"
    return stream
