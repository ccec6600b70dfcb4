"""Import of two videos of one drive, whose clocks are unrelated, or of one."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event

import cv2
import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.interchange.clocks import Relation, check_steady, relate
from calm_edge.interchange.picture_spool import PictureSpool
from calm_edge.interchange.sound import heard, loudness
from calm_edge.interchange.turns import TurnMeter
from calm_edge.interchange.video import SUFFIXES, Video, parts, require_av, rotated
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.types import Int
from device.frame import Eye, Frame, jpeg

PROGRESS_S = 20.0
# pictures of cameras mounted alike differ less than this in their rotation about the axis
UPRIGHT_DEG = 45.0


@dataclass(slots=True)
class _Track:
    """One video while it is read: its pictures on the disk, and its turns."""

    eye: Eye
    video: Video
    spool: PictureSpool
    meter: TurnMeter = field(default_factory=TurnMeter)

    @property
    def name(self) -> str:
        return self.eye.name.lower()


class VideoPair:
    """Importer of one or two videos, each a file or a folder with the parts of one."""

    name = "video"
    reads = "two videos (mp4, mov, mkv, avi, ts ...), or folders with the parts of each"

    def recognises(self, sources: tuple[Path, ...]) -> bool:
        """Whether every source is a video file, or a folder with some."""
        return all(_is_video(source) for source in sources)

    def open(
        self,
        sources: tuple[Path, ...],
        options: ImportOptions,
        scratch: Path,
        say: Callable[[str], None],
    ) -> Imported:
        """Decode both videos to `scratch` and relate their clocks; raises InterchangeError."""
        require_av()
        if len(sources) == 1 and not options.single:
            raise InterchangeError(
                f"{sources[0]}: one camera has no spacing, so nothing gives the metre; give the "
                "video of the second camera too, or --single for a recording of one"
            )
        turns = options.turn_deg or (None,) * len(sources)
        if len(turns) != len(sources):
            raise InterchangeError(f"--rotate: give {len(sources)} values, one for each video")
        tracks = [
            _Track(eye, Video(parts(source), turn), PictureSpool(scratch / f"{eye.name.lower()}"))
            for eye, source, turn in zip(Eye, sources, turns, strict=False)
        ]
        _read(tracks, options.quality, say)
        relation = None
        if len(tracks) == 2 and options.offset_s is None:
            relation = _relation(tracks, options, say)
        return _imported(tracks, relation, options)


def _is_video(source: Path) -> bool:
    if source.is_dir():
        return any(p.suffix.lower() in SUFFIXES for p in source.iterdir())
    return source.suffix.lower() in SUFFIXES


def _read(tracks: list[_Track], quality: int, say: Callable[[str], None]) -> None:
    """Decode all tracks, each in a thread of its own; the first failure ends all."""
    stop = Event()

    def read(track: _Track) -> None:
        said = time.monotonic()
        try:
            for t_s, picture in track.video.pictures():
                if stop.is_set():
                    return
                track.spool.add(t_s, jpeg(picture, quality))
                track.meter.add(t_s, picture)
                if time.monotonic() - said > PROGRESS_S:
                    said = time.monotonic()
                    say(f"{track.name}: {t_s:.0f} s read")
        except BaseException:
            stop.set()
            raise
        finally:
            track.spool.close()

    with ThreadPoolExecutor(len(tracks)) as pool:
        jobs = [pool.submit(read, track) for track in tracks]
        try:
            for job in jobs:
                job.result()
        except BaseException:
            stop.set()
            raise


def _relation(tracks: list[_Track], options: ImportOptions, say: Callable[[str], None]) -> Relation:
    primary, assistant = (track.meter.turns() for track in tracks)
    # of the first part alone: the times of the others are only assumed
    sounds = [loudness(t.video.files[0], t.video.report.first_s) for t in tracks]
    relation = relate(primary, assistant, heard(sounds[0], sounds[1]))
    if not options.unsteady:
        check_steady(relation, primary, assistant)
    return relation


def _imported(tracks: list[_Track], relation: Relation | None, options: ImportOptions) -> Imported:
    stamps = [track.spool.t_s for track in tracks]
    assumed = [note for track in tracks for note in _assumed(track)]
    took = [_took(track, t[-1], options.quality) for track, t in zip(tracks, stamps, strict=True)]
    facts: dict[str, str] = {}
    turn = 0
    if len(tracks) == 1:
        assumed.append("one camera: lengths have no metre")
    elif relation is None:
        stamps[1] = stamps[1] + (options.offset_s or 0.0)
        assumed.append(f"clock offset {options.offset_s:+g} s and no drift, as given")
    else:
        stamps[1] = relation.fit.primary_time(stamps[1])
        took += relation.lines()
        facts = relation.facts()
        turn = _upside_down(relation, options)
        if turn:
            assumed.append("assistant: its picture is upside down; rotated by 180 degrees")
    t_ns, dropped = _on_one_clock(stamps)
    faults = [line for track in tracks for line in _faults(track)]
    skipped = {track.eye: n for track, n in zip(tracks, dropped, strict=True)}
    if any(dropped):
        faults.append(
            f"{sum(dropped)} pictures of the assistant more than 1 s before the primary's first"
        )

    def frames(eye: Eye) -> Iterator[Frame]:
        track, first = tracks[eye], skipped[eye]
        for k, data in enumerate(track.spool.pictures()):
            if k >= first:
                data = _turned(data, turn, options.quality) if eye is Eye.ASSISTANT else data
                yield Frame(eye, k - first, int(t_ns[eye][k]), data)

    eyes = tuple(track.eye for track in tracks)
    return Imported(eyes, frames, tuple(took), tuple(faults), tuple(assumed), facts=facts)


def _on_one_clock(stamps: list[np.ndarray]) -> tuple[list[Int], list[int]]:
    """Nanoseconds of the stamps, and how many first ones of each camera are before time 0."""
    t_ns = [np.round(t * 1e9).astype(np.int64) + ORIGIN_NS for t in stamps]
    return t_ns, [int((t <= 0).sum()) for t in t_ns]


def _upside_down(relation: Relation, options: ImportOptions) -> int:
    """180 if the assistant's picture is upside down; raises InterchangeError if it lies."""
    roll = relation.fit.roll_deg
    if abs(roll) < UPRIGHT_DEG or options.turn_deg is not None:
        return 0
    if abs(roll) > 180 - UPRIGHT_DEG:
        return 180
    raise InterchangeError(
        f"assistant: its picture is rotated by {roll:.0f} degrees against the primary's; say how "
        "each has to be rotated clockwise, e.g. --rotate 0 90"
    )


def _turned(data: bytes, degrees: int, quality: int) -> bytes:
    if not degrees:
        return data
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    return jpeg(rotated(np.asarray(picture, np.uint8), degrees), quality)


def _took(track: _Track, last_s: float, quality: int) -> str:
    report, files = track.video.report, track.video.files
    n = len(track.spool.t_s)
    name = str(files[0]) if len(files) == 1 else f"{files[0].parent} ({len(files)} parts)"
    turned = f", rotated by {report.turned_deg} degrees" if report.turned_deg else ""
    return (
        f"{track.name} {name}: {n} pictures of {report.size[0]}x{report.size[1]} in {last_s:.2f} s "
        f"({(n - 1) / last_s:.2f} a second), {report.codec}{turned}; JPEG of quality {quality}"
    )


def _assumed(track: _Track) -> list[str]:
    report = track.video.report
    lines = [f"{track.name}: {note}" for note in report.notes]
    if report.joins_s:
        lines.append(f"{track.name}: no time passed between its {len(track.video.files)} parts")
    return lines


def _faults(track: _Track) -> list[str]:
    report = track.video.report
    lines = []
    if report.repeated:
        lines.append(f"{track.name}: {report.repeated} pictures whose stamp is not after the last")
    if report.broken:
        lines.append(f"{track.name}: {report.broken} packets or pictures that are damaged")
    if report.ended:
        lines.append(report.ended)
    return lines
