"""Read a drive stored as a folder of pictures for each camera, and optional files of their times.

Ground truth in the same folder (`calib.txt`, `poses0.txt`) is read by `evaluation` only.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calm_edge.recording import SequenceError
from calm_edge.recording.picture_file import SUFFIXES
from calm_edge.recording.picture_folder import PictureFolder
from calm_edge.recording.segment import segment_files
from calm_edge.recording.stamp_order import check_common_time, ordered
from calm_edge.recording.stamp_text import read_stamps
from calm_edge.types import Int
from device.frame import Eye, Frame, Unusable

# added to every stamp, so that stamps from 0 s on are positive
ORIGIN_NS = 1_000_000_000

# folder of each camera's pictures and file of their times; the first layout found counts
_LAYOUTS = (
    ("cam{}", "times{}.txt"),
    # EuRoC
    ("mav0/cam{}/data", "mav0/cam{}/data.csv"),
    ("cam{}/data", "cam{}/data.csv"),
)
_IMPORTED = {".mp4", ".mov", ".avi", ".mkv", ".m4v", ".webm", ".ts", ".bag", ".db3"}


def read_times(path: Path) -> Int:
    """Read stamps (N,) in ns from a file of times as `stamp_text` does; ORIGIN_NS is added.

    Single ones out of order are replaced (`stamp_order`). Raises SequenceError if they do not
    increase otherwise.
    """
    t_ns, _ = ordered(read_stamps(path).t_ns)
    if (np.diff(t_ns) <= 0).any():
        raise SequenceError(f"{path}: its times do not increase from line to line")
    return np.asarray(t_ns + ORIGIN_NS)


class SequenceFolder:
    """A folder with `cam0/ cam1/` and optional `times0.txt times1.txt`, or in EuRoC's layout.

    Stamps are those of the files or of the pictures' names plus ORIGIN_NS; without either, both
    cameras run at 10 Hz. notes: lines for the user on how the folder was read. Raises
    SequenceError.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        folders, times = _layout(self.path)
        pair = [
            PictureFolder(folder, file if file.is_file() else None)
            for folder, file in zip(folders, times, strict=True)
        ]
        self._cameras = pair[0], pair[1]
        for camera, file in zip(pair, times, strict=True):
            if not camera.has_times and any(each.has_times for each in pair):
                raise SequenceError(f"{file}: missing; give times of both cameras, or of neither")
        self._t_ns = tuple(camera.t_ns + ORIGIN_NS for camera in pair)
        self.notes = tuple(dict.fromkeys(note for camera in pair for note in camera.notes))
        check_common_time(
            self.path,
            [str(folder.relative_to(self.path)) for folder in folders],
            [t_ns - ORIGIN_NS for t_ns in self._t_ns],
        )

    def count(self, eye: Eye) -> int:
        """Number of frames of an eye."""
        return len(self._cameras[eye].files)

    def size(self, eye: Eye) -> tuple[int, int]:
        """(width, height) in px of an eye's first image, decoded."""
        return self._cameras[eye].size

    def t_ns(self, eye: Eye) -> Int:
        """Stamps (N,) in ns of an eye's frames."""
        return self._t_ns[eye].copy()

    def file(self, eye: Eye, sequence: int) -> Path:
        """File of one frame."""
        return self._cameras[eye].files[sequence]

    def stream(self, eye: Eye) -> Iterator[Frame | Unusable]:
        """Iterate over an eye's frames; an Unusable stands for a file that is not a picture."""
        return self._cameras[eye].frames(eye, ORIGIN_NS)

    def frames(self, eye: Eye) -> Iterator[Frame]:
        """Iterate over an eye's frames as `stream`; raises SequenceError for an Unusable."""
        for frame in self.stream(eye):
            if isinstance(frame, Unusable):
                raise SequenceError(f"{frame.reason}; replace it or remove it from the folder")
            yield frame


def _layout(path: Path) -> tuple[list[Path], list[Path]]:
    """Folders of pictures and files of times of both cameras, present or not."""
    if path.is_file():
        command = "record --replay" if path.suffix == ".mcap" else "calm-edge import"
        if path.suffix.lower() not in (*_IMPORTED, ".mcap"):
            command = "record --sequence with its folder"
        raise SequenceError(f"{path}: a file, not a folder of pictures; use {command}")
    if not path.is_dir():
        raise SequenceError(f"{path}: no such folder; a sequence holds cam0/ and cam1/")
    for camera, times in _LAYOUTS:
        folders = [path / camera.format(int(eye)) for eye in Eye]
        if all(_holds(folder, SUFFIXES) for folder in folders):
            return folders, [path / times.format(int(eye)) for eye in Eye]
    folders = [path / f"cam{int(eye)}" for eye in Eye]
    if segment_files(path):
        raise SequenceError(f"{path}: a recording, not a folder of pictures; use record --replay")
    for folder in folders:
        if _holds(folder, _IMPORTED) or _holds(path, _IMPORTED):
            raise SequenceError(f"{path}: holds videos or bags, not pictures; use calm-edge import")
        if not folder.is_dir():
            raise SequenceError(
                f"{folder}: missing; calm-edge needs both cam0/ and cam1/, or use calm-edge import"
            )
    return folders, [path / f"times{int(eye)}.txt" for eye in Eye]


def _holds(folder: Path, suffixes: Sequence[str] | set[str] | frozenset[str]) -> bool:
    try:
        return any(
            file.suffix.lower() in suffixes and not file.name.startswith(".")
            for file in folder.iterdir()
        )
    except OSError:
        return False
