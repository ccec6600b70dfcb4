"""Read the pictures of one camera from a folder, with their stamps."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from calm_edge.recording import SequenceError
from calm_edge.recording.picture_file import SUFFIXES, PictureError, PictureFiles
from calm_edge.recording.stamp_order import MAX_WRONG_SHARE, Bool, ordered
from calm_edge.recording.stamp_text import StampRows, read_stamps, stamps_in_names
from calm_edge.types import Int
from device.frame import Eye, Frame, Unusable

DEFAULT_RATE_HZ = 10.0
# pictures that are not read
_CONVERTIBLE = {".heic", ".HEIC", ".heif", ".avif", ".jp2", ".gif", ".dng", ".cr2", ".nef", ".exr"}


class PictureFolder:
    """Pictures of one camera in a folder, in natural order, without hidden files.

    times: file of their stamps, one a picture in their order, or naming them; None: their names if
    these are times, else DEFAULT_RATE_HZ. t_ns: (N,) stamps in ns as written, in order. own: (N,)
    False where a stamp was out of order and has been replaced. has_times: False at the assumed
    rate. size: (width, height) px of the first picture, decoded. notes: lines for the user on how
    the folder was read. Raises SequenceError.
    """

    def __init__(self, folder: Path, times: Path | None = None) -> None:
        self.folder = folder
        self.files: Sequence[Path] = pictures(folder)
        self.has_times = True
        self._notes: list[str] = []
        if times is not None:
            rows = read_stamps(times)
            self.files, index = _matched(self.files, times, rows, self._notes)
            lines = np.array(rows.lines)[index]
            self._stamp(rows.t_ns[index], times, rows.unit, [f"line {n}" for n in lines])
        elif (named := stamps_in_names([file.stem for file in self.files])) is not None:
            order = np.argsort(named[0], kind="stable")
            self.files = [self.files[i] for i in order]
            where = [file.name for file in self.files]
            self._stamp(named[0][order], folder, f"{named[1]}, from the names", where)
        else:
            self.has_times = False
            self.t_ns = np.arange(len(self.files), dtype=np.int64) * round(1e9 / DEFAULT_RATE_HZ)
            self.own: Bool = np.ones(len(self.files), bool)
            self._notes.append(f"{folder}: no times are given: {DEFAULT_RATE_HZ:g} Hz is assumed")
        self._reader = PictureFiles(self.files)

    @property
    def size(self) -> tuple[int, int]:
        return self._reader.size

    @property
    def notes(self) -> tuple[str, ...]:
        return (*self._notes, *self._reader.notes)

    def frames(self, eye: Eye, shift_ns: int = 0) -> Iterator[Frame | Unusable]:
        """Iterate over the pictures as frames of an eye, numbered from 0.

        A JPEG stays encoded, other pictures are (H, W, 3) BGR. A file that is not a picture gives
        an Unusable in its place. shift_ns: added to all stamps.
        """
        for i, file in enumerate(self.files):
            try:
                image = self._reader.read(file)
            except PictureError as error:
                yield Unusable(eye, i, str(error))
                continue
            yield Frame(eye, i, int(self.t_ns[i]) + shift_ns, image, bool(self.own[i]))

    def _stamp(self, t_ns: Int, source: Path, unit: str, where: Sequence[str]) -> None:
        """Set stamps as read from `source`. where: of each frame, its place there."""
        if unit != "s":
            self._notes.append(f"{source}: times are read as {unit}")
        self.t_ns, self.own = ordered(t_ns)
        wrong = np.flatnonzero(~self.own)
        if len(wrong) == 0:
            return
        what = f"{source}: {where[wrong[0]]}: {t_ns[wrong[0]] / 1e9:.6f} s"
        if len(wrong) > MAX_WRONG_SHARE * len(t_ns) or (np.diff(self.t_ns) <= 0).any():
            raise SequenceError(
                f"{what} and {len(wrong) - 1} more are not after the stamp before; stamps must "
                "increase from picture to picture"
            )
        moved_s = (int(self.t_ns[-1]) - int(t_ns[-1])) / 1e9 if self.own[-1] else 0.0
        was_set = (
            f"; the clock was set: later ones are shifted by {moved_s:.3f} s" if moved_s else ""
        )
        self._notes.append(
            f"{what} does not follow the one before, {len(wrong)} stamps in all; they are replaced "
            f"by equal steps, and these frames give no velocity{was_set}"
        )


def pictures(folder: Path) -> list[Path]:
    """List the picture files of a folder in natural order (2 before 10); raises SequenceError."""
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries if _is_file(entry)]
    except OSError as error:
        raise SequenceError(f"{folder}: cannot be read ({error.strerror})") from None
    # .name: hidden; ._name: what macOS adds to each file on foreign disks
    seen = [n for n in names if not n.startswith(".") and Path(n).suffix.lower() in SUFFIXES]
    if not seen:
        known = ", ".join(sorted(SUFFIXES))
        others = sorted({Path(name).suffix for name in names if Path(name).suffix in _CONVERTIBLE})
        remedy = f"convert its {', '.join(others)}" if others else "put this camera's there"
        raise SequenceError(f"{folder}: holds no pictures ({known}); {remedy}")
    return [folder / name for name in sorted(seen, key=_natural)]


def _is_file(entry: os.DirEntry[str]) -> bool:
    """Whether it is a file; also a link that leads nowhere, a picture that cannot be read."""
    if entry.is_symlink() and not Path(entry).exists():
        return True
    return entry.is_file()


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key that compares numbers within names by value."""
    parts = re.split(r"([0-9]+)", name)
    return [(int(part), part) if i % 2 else (0, part) for i, part in enumerate(parts)]


def _matched(
    files: Sequence[Path], times: Path, rows: StampRows, notes: list[str]
) -> tuple[Sequence[Path], Int]:
    """Files with stamps, and the row of each: by name, by number, or one a line."""
    n, m = len(files), len(rows.t_ns)
    row_of = {Path(name).name: i for i, name in enumerate(rows.names) if name}
    named = [row_of.get(file.name, row_of.get(file.stem, -1)) for file in files]
    if max(named) < 0:
        numbers = [int(file.stem) if file.stem.isdecimal() else -1 for file in files]
        missing = m > n and min(numbers) >= 0 and max(numbers) < m and len(set(numbers)) == n
        if n != m and not missing:
            raise SequenceError(
                f"{times}: {m} times for {n} images in {files[0].parent}; it must hold one line "
                "per image, or name them"
            )
        if n == m:
            return files, np.arange(n)
        named = numbers
    index = np.array(named, np.int64)
    if left_out := int((index < 0).sum()):
        notes.append(f"{times}: names no time for {left_out} of {n} pictures; they are left out")
    if unseen := m - len(set(index[index >= 0].tolist())):
        notes.append(f"{times}: {unseen} of {m} times have no picture in {files[0].parent}")
    order = np.argsort(np.where(index < 0, m, index), kind="stable")[: n - left_out]
    return [files[i] for i in order], index[order]
