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
from calm_edge.interchange.base import ONE_CAMERA, Imported, ImportOptions
from calm_edge.interchange.clock_parts import Gap, find_gaps, increasing, shifted, with_stamps
from calm_edge.interchange.clocks import Relation, check_steady, relate
from calm_edge.interchange.picture_spool import PictureSpool
from calm_edge.interchange.sound import heard, loudness
from calm_edge.interchange.turns import TurnMeter
from calm_edge.interchange.video import SUFFIXES, Video, parts, require_av, rotated
from calm_edge.recording.sequence_folder import ORIGIN_NS
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
                "video of the second camera too, or --single to keep its pictures"
            )
        turns = options.turn_deg or (None,) * len(sources)
        if len(turns) != len(sources):
            raise InterchangeError(f"--rotate: give {len(sources)} values, one for each video")
        tracks = [
            _Track(eye, Video(parts(source), turn), PictureSpool(scratch / f"{eye.name.lower()}"))
            for eye, source, turn in zip(Eye, sources, turns, strict=False)
        ]
        _read(tracks, options.quality, say)
        related = len(tracks) == 2 and options.offset_s is None
        return _imported(tracks, _relation(tracks, options) if related else None, options)


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


def _relation(tracks: list[_Track], options: ImportOptions) -> tuple[Relation, list[Gap]]:
    """Relation of the clocks, and the gaps between the parts of the videos."""
    turns = [track.meter.turns() for track in tracks]
    joins = [track.video.report.joins_s for track in tracks]
    gaps = find_gaps(turns[0], turns[1], (joins[0], joins[1]))
    primary, assistant = (
        with_stamps(t, shifted(t.t_s, gaps, track.eye))
        for t, track in zip(turns, tracks, strict=True)
    )
    # of the first part alone: the times of the others are only assumed
    sounds = [loudness(t.video.files[0], t.video.report.first_s) for t in tracks]
    relation = relate(primary, assistant, heard(sounds[0], sounds[1]))
    if not options.unsteady:
        check_steady(relation, primary, assistant)
    return relation, gaps


def _imported(
    tracks: list[_Track], found: tuple[Relation, list[Gap]] | None, options: ImportOptions
) -> Imported:
    stamps = [track.spool.t_s for track in tracks]
    took = [_took(track, t[-1], options.quality) for track, t in zip(tracks, stamps, strict=True)]
    assumed = [note for track in tracks for note in _assumed(track)]
    facts: dict[str, str] = {}
    turn = 0
    if len(tracks) == 1:
        assumed.append(ONE_CAMERA)
    elif found is None:
        stamps[1] = stamps[1] + (options.offset_s or 0.0)
        assumed.append(f"clock offset {options.offset_s:+g} s and no drift, as given")
    else:
        relation, gaps = found
        stamps = [shifted(t, gaps, track.eye) for t, track in zip(stamps, tracks, strict=True)]
        stamps[1] = relation.fit.primary_time(stamps[1])
        took += [*relation.lines(), *(gap.line() for gap in gaps)]
        facts = relation.facts()
        turn = _upside_down(relation, options)
        if turn:
            assumed.append("assistant: its picture is upside down; rotated by 180 degrees")
    t_ns = [np.round(t * 1e9).astype(np.int64) + ORIGIN_NS for t in stamps]
    kept = [increasing(t_s) & (t > 0) for t_s, t in zip(stamps, t_ns, strict=True)]
    faults = [line for track in tracks for line in _faults(track)]
    for track, t, keep in zip(tracks, t_ns, kept, strict=True):
        if early := int((t <= 0).sum()):
            faults.append(f"{track.name}: {early} pictures over 1 s before the primary's first")
        if twice := int((~keep & (t > 0)).sum()):
            faults.append(f"{track.name}: {twice} pictures filmed twice")

    def frames(eye: Eye) -> Iterator[Frame]:
        sequence = 0
        for data, t, keep in zip(tracks[eye].spool.pictures(), t_ns[eye], kept[eye], strict=True):
            if keep:
                data = _turned(data, turn, options.quality) if eye is Eye.ASSISTANT else data
                yield Frame(eye, sequence, int(t), data)
                sequence += 1

    eyes = tuple(track.eye for track in tracks)
    return Imported(eyes, frames, tuple(took), tuple(faults), tuple(assumed), facts=facts)


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
        lines.append(f"{track.name}: no time passed between its parts, but for what is reported")
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
