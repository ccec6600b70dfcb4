"""Protocol of importers: what a source holds, as frames of both cameras on one clock."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from calm_edge.interchange.calibration.calibration import Calibration
from calm_edge.recording.sensors import Sample
from calm_edge.types import Float, Int
from device.frame import JPEG_QUALITY, Eye, Frame

# assumed of an import with a single camera
ONE_CAMERA = "one camera: its pictures are kept, for poses and maps the second one is missing"


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """What the user asked for.

    single: accept one camera. offset_s: assistant's clock behind the primary's, None to find it.
    quality: of JPEG pictures that have to be encoded. topics: of a bag, one for each camera.
    turn_deg: clockwise rotation of each camera's pictures, None for what the file says.
    unsteady: accept stabilised video.
    """

    single: bool = False
    offset_s: float | None = None
    quality: int = JPEG_QUALITY
    topics: tuple[str, str] = ("", "")
    turn_deg: tuple[int, ...] | None = None
    unsteady: bool = False


@dataclass(frozen=True, slots=True)
class GroundTruth:
    """True path of the primary camera: t_ns (N,) on the frames' clock, T_w_c (N, 4, 4) metres."""

    t_ns: Int
    T_w_c: Float


@dataclass(frozen=True, slots=True)
class Imported:
    """Frames of one or two cameras, encoded and in order, and what the source says beside.

    frames: (eye) -> its frames, stamped from ORIGIN_NS of sequence folders on. took, dropped,
    assumed: a line each; dropped is complete when all frames have been read. calibration: as
    published. samples: GPS fixes and IMU samples on the frames' clock, by time. facts: for the
    recording's metadata.
    """

    eyes: tuple[Eye, ...]
    frames: Callable[[Eye], Iterator[Frame]]
    took: tuple[str, ...] = ()
    dropped: Sequence[str] = ()
    assumed: tuple[str, ...] = ()
    truth: GroundTruth | None = None
    calibration: Calibration | None = None
    samples: Sequence[Sample] = ()
    facts: dict[str, str] = field(default_factory=dict)


class Importer(Protocol):
    """Reader of one format. `name` is the format's, `reads` describes what it opens."""

    name: str
    reads: str

    def recognises(self, sources: tuple[Path, ...]) -> bool:
        """Whether the sources look like this format; reads no more than names and headers."""
        ...

    def open(
        self,
        sources: tuple[Path, ...],
        options: ImportOptions,
        scratch: Path,
        say: Callable[[str], None],
    ) -> Imported:
        """Open the sources; scratch: a folder for temporary files. Raises InterchangeError."""
        ...
