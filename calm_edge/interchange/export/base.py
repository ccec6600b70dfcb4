"""Protocol of exporters: one format, written to a folder that is empty."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from calm_edge.interchange.export.drive import ExportedDrive
from device.frame import JPEG_QUALITY


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """What the user asked for.

    distorted: keep the pictures as recorded and export the lens with its distortion; by default
    they are undistorted to a pinhole camera. binary: of formats that have a text and a binary form.
    quality: of JPEG pictures that have to be encoded. every_frame: of formats with pictures, all
    frames that have a pose instead of the keyframes alone.
    """

    distorted: bool = False
    binary: bool = False
    quality: int = JPEG_QUALITY
    every_frame: bool = False


@dataclass(frozen=True, slots=True)
class Written:
    """What an exporter wrote, assumed and left out: a line each."""

    wrote: tuple[str, ...]
    assumed: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


class Exporter(Protocol):
    """Writer of one format. `name` is the format's, `writes` describes its files."""

    name: str
    writes: str

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write the files to an empty folder; raises InterchangeError or RecordingError."""
        ...
