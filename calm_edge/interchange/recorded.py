"""Write imported frames as a recording, which is complete or not there."""

from __future__ import annotations

import heapq
import json
import shutil
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TypeVar

from calm_edge.config import Config
from calm_edge.geometry import se3
from calm_edge.geometry.camera_row import camera_row
from calm_edge.interchange import InterchangeError
from calm_edge.interchange.base import Imported
from calm_edge.interchange.calibration import formats
from calm_edge.recording import time_base
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import IMPORT_METADATA
from calm_edge.recording.sensors import Sample
from calm_edge.recording.sequence_folder import ORIGIN_NS
from calm_edge.recording.writer import RecordingWriter
from calm_edge.trajectories import seconds, write_kitti
from device.atomic_file import sync_folder
from device.frame import Eye, Frame

_Timed = TypeVar("_Timed", Frame, Sample)

TRUTH, CALIBRATION = "truth", "calibration"
# marks a folder that an import has begun; nothing else is ever removed
_MARK = "unfinished import, may be removed"


@contextmanager
def unfinished(out: Path, say: Callable[[str], None]) -> Iterator[Path]:
    """Folder beside `out` to write to; it becomes `out` on success and is removed on failure.

    What an interrupted import left there is removed. Raises InterchangeError if `out` exists.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InterchangeError(f"{out}: exists; choose another output folder")
    part = out.with_name(out.name + ".importing")
    mark = part / _MARK
    if part.exists():
        if not mark.is_file():
            raise InterchangeError(f"{part}: exists and is not an import's; move it away")
        say(f"{part}: left by an interrupted import; removed, beginning anew")
        shutil.rmtree(part)
    try:
        part.mkdir(parents=True)
        mark.touch()
    except OSError as error:
        raise InterchangeError(f"{part}: cannot be written ({error.strerror})") from None
    try:
        yield part
        mark.unlink()
        if out.exists():
            out.rmdir()
        part.rename(out)
        sync_folder(out.parent)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def write(imported: Imported, config: Config, folder: Path, name: str) -> dict[Eye, int]:
    """Write the frames to a recording in `folder`, verify it, return the number of frames.

    name: of the format. Ground truth goes to the sub-folder TRUTH, a calibration to CALIBRATION.
    Raises CalmEdgeError.
    """
    counts = dict.fromkeys(imported.eyes, 0)
    streams = [imported.frames(eye) for eye in imported.eyes]
    frames = heapq.merge(*streams, key=lambda f: (f.t_ns, f.eye))
    samples = deque(imported.samples)
    first = next(frames, None)
    times = [item.t_ns for item in (first, *list(samples)[:1]) if item is not None]
    shift_ns = time_base.lift_ns(min(times, default=ORIGIN_NS))
    now = shift_ns + (ORIGIN_NS if first is None else first.t_ns)
    writer = RecordingWriter(
        folder,
        config,
        {"cameras": f"imported: {name}"},
        lossless=True,
        time_base=time_base.of_stamps(ORIGIN_NS + shift_ns, now, lockstep=True),
        now_ns=lambda: now,
    )
    try:
        for frame in chain([] if first is None else [first], frames):
            while samples and samples[0].t_ns <= frame.t_ns:
                now = max(now, samples[0].t_ns + shift_ns)
                writer.write_sample(_later(samples.popleft(), shift_ns))
            now = frame.t_ns + shift_ns
            writer.write_frame(_later(frame, shift_ns))
            counts[frame.eye] += 1
        for sample in samples:
            now = max(now, sample.t_ns + shift_ns)
            writer.write_sample(_later(sample, shift_ns))
        writer.write_metadata(IMPORT_METADATA, _facts(imported, name))
    finally:
        health = writer.close()
    if health.error:
        raise InterchangeError(health.error)
    _verify(folder, counts)
    if imported.calibration is not None:
        formats.write("opencv", folder / CALIBRATION, imported.calibration, (f"as in the {name}",))
    if imported.truth is not None:
        _write_truth(imported, folder / TRUTH)
    return counts


def _later(item: _Timed, shift_ns: int) -> _Timed:
    return replace(item, t_ns=item.t_ns + shift_ns) if shift_ns else item


def _facts(imported: Imported, name: str) -> dict[str, str]:
    return {
        "format": name,
        "took": json.dumps(imported.took),
        "dropped": json.dumps(list(imported.dropped)),
        "assumed": json.dumps(imported.assumed),
        **imported.facts,
    }


def remove(scratch: Path) -> None:
    """Remove the folder of temporary files."""
    shutil.rmtree(scratch)


def _verify(folder: Path, counts: dict[Eye, int]) -> None:
    recording = Recording(folder)
    for eye, count in counts.items():
        found = len(recording.frame_times(eye))
        if recording.losses or found != count or not count:
            reason = recording.losses[0] if recording.losses else f"{found} of {count}"
            raise InterchangeError(f"{folder}: {eye.name.lower()} frames not written ({reason})")


def _write_truth(imported: Imported, folder: Path) -> None:
    """Write poses0.txt, times0.txt and, if both are known, calib.txt, as `eval` reads them."""
    assert imported.truth is not None
    folder.mkdir()
    write_kitti(folder / "poses0.txt", se3.inverse(imported.truth.T_w_c[0]) @ imported.truth.T_w_c)
    stamps = (imported.truth.t_ns - ORIGIN_NS).tolist()
    (folder / "times0.txt").write_text("".join(f"{seconds(t)}\n" for t in stamps))
    cameras = [] if imported.calibration is None else imported.calibration.cameras
    if len(cameras) == 2:
        rows = "".join(f"{camera_row(each.camera)}\n" for each in cameras)
        (folder / "calib.txt").write_text(rows)
