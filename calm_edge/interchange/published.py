"""Text files and folders of published data sets, and a drive as these describe it."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calm_edge.geometry import se3
from calm_edge.interchange import InterchangeError
from calm_edge.interchange.base import GroundTruth, Imported
from calm_edge.interchange.calibration.calibration import Calibration
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Float, Int
from device.frame import Eye, Frame, UnreadableImage


class DatasetError(InterchangeError):
    """A dataset's folder does not have the published layout."""


def folder(path: Path, what: str) -> Path:
    """Return `path` if it is a folder, else raise DatasetError.

    what: description of the expected content, for the message.
    """
    if not path.is_dir():
        raise DatasetError(f"{path}: no such folder; it should hold {what}")
    return path


def lines(path: Path, what: str) -> list[str]:
    """Read the non-blank lines of a text file; raises DatasetError.

    what: description of the expected content, for the message.
    """
    try:
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError):
        raise DatasetError(f"{path}: cannot be read; it should hold {what}") from None
    return [line for line in text.splitlines() if line.strip()]


def numbers(path: Path, line: str, columns: Iterable[int]) -> Float:
    """Parse the numbers (C,) of one line of `path`.

    columns: allowed values of C. Raises DatasetError.
    """
    try:
        values = np.array([float(word) for word in line.replace(",", " ").split()])
    except ValueError:
        raise DatasetError(f"{path}: not a row of numbers: {line[:60]!r}") from None
    allowed = tuple(columns)
    if len(values) not in allowed or not np.isfinite(values).all():
        wanted = " or ".join(map(str, allowed))
        raise DatasetError(f"{path}: a row has {len(values)} numbers; {wanted} are expected")
    return values


def keyed(path: Path, what: str) -> dict[str, str]:
    """Read the lines `key: values` of a text file as {key: values}; raises DatasetError."""
    pairs = (line.partition(":") for line in lines(path, what))
    return {key.strip(): value.strip() for key, _, value in pairs}


def entry(path: Path, rows: dict[str, str], key: str, count: int) -> Float:
    """The numbers (count,) of one key; raises DatasetError."""
    if key not in rows:
        raise DatasetError(f"{path}: no line `{key}:`")
    return numbers(path, rows[key], (count,))


def projection(path: Path, rows: dict[str, str], key: str) -> tuple[Float, Float]:
    """K (3, 3) px of a rectified camera, and its centre (3,) [m] in the reference camera's frame.

    rows: {key: 12 numbers of P = K [I | t]}; the centre is -t. Raises DatasetError.
    """
    P = entry(path, rows, key, 12).reshape(3, 4)
    return P[:, :3], np.asarray(-np.linalg.solve(P[:, :3], P[:, 3]))


def dated(path: Path) -> Int:
    """Read stamps (L,) ns from lines `YYYY-MM-DD HH:MM:SS.nnnnnnnnn`, without rounding."""
    out = []
    for line in lines(path, "a date and time a row"):
        whole, _, part = line.strip().partition(".")
        try:
            at = datetime.datetime.strptime(whole, "%Y-%m-%d %H:%M:%S")
            fraction = int(part.ljust(9, "0")[:9] or 0)
        except ValueError:
            raise DatasetError(f"{path}: {line.strip()!r} is not a date and time") from None
        seconds = at.replace(tzinfo=datetime.UTC).timestamp()
        out.append(int(seconds) * 10**9 + fraction)
    return np.array(out, np.int64)


def pngs(path: Path, what: str) -> tuple[Path, ...]:
    """PNG files of a folder, sorted by name; raises DatasetError if there are none."""
    found = tuple(sorted(p for p in folder(path, what).iterdir() if p.suffix.lower() == ".png"))
    if not found:
        raise DatasetError(f"{path}: empty; it should hold {what}")
    return found


@dataclass(frozen=True, slots=True)
class Published:
    """A drive of a data set.

    pictures, t_ns: (N,) files and their stamps, one entry an eye. truth: (M,) ns and T_w_c (M, 4,
    4) m of the primary camera. Others as in `Imported`.
    """

    pictures: tuple[tuple[Path, ...], tuple[Path, ...]]
    t_ns: tuple[Int, Int]
    calibration: Calibration
    truth: tuple[Int, Float] | None = None
    dropped: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


def size(path: Path) -> tuple[int, int]:
    """(width, height) of a picture [px]; raises DatasetError."""
    try:
        height, width = Frame(Eye.PRIMARY, 0, 0, path.read_bytes()).gray().shape
    except (OSError, UnreadableImage):
        raise DatasetError(f"{path}: not a readable picture") from None
    return width, height


def imported(drive: Published, name: str) -> Imported:
    """The drive as frames with the files' bytes, unchanged. name: of the data set."""
    for eye in Eye:
        if not drive.pictures[eye]:
            raise DatasetError(f"{name}: the {eye.name.lower()} camera has no picture with a stamp")

    def frames(eye: Eye) -> Iterator[Frame]:
        for k, (t, path) in enumerate(zip(drive.t_ns[eye], drive.pictures[eye], strict=True)):
            try:
                data = path.read_bytes()
            except OSError as error:
                raise DatasetError(f"{path}: cannot be read ({error.strerror})") from None
            yield Frame(eye, k, int(t) + ORIGIN_NS, data)

    took = [
        f"{eye.name.lower()} {drive.pictures[eye][0].parent}: {len(drive.t_ns[eye])} pictures of "
        f"{name}, unchanged"
        for eye in Eye
    ]
    truth = None
    if drive.truth is not None:
        truth = true_poses(drive.t_ns[Eye.PRIMARY], *drive.truth)
        took.append(f"true poses of {len(truth.t_ns)} of the primary's pictures")
    return Imported(
        tuple(Eye),
        frames,
        tuple(took),
        drive.dropped,
        (*drive.assumed, "calibration as published, for the cameras' spacing"),
        truth=truth,
        calibration=drive.calibration,
    )


def true_poses(t_ns: Int, known_ns: Int, T_w_c: Float) -> GroundTruth:
    """Interpolate true poses at the pictures' stamps (N,); those outside are left out."""
    inside = t_ns[(t_ns >= known_ns[0]) & (t_ns <= known_ns[-1])]
    if not len(inside):
        raise DatasetError("the true poses and the pictures have no time in common")
    seconds = (known_ns - known_ns[0]) / 1e9
    T = se3.interpolate_at(seconds, T_w_c, (inside - known_ns[0]) / 1e9)
    return GroundTruth(inside + ORIGIN_NS, T)
