"""Import drives as two phone-like videos, and compare them with the folders they are made of.

The primary's video keeps the stamps of its pictures; the assistant's lacks every sixth picture,
begins later by a clock of its own, and is stored upside down with the rotation that phones write.
The table has the error of the clock offset and its sigma, and the trajectory errors of both.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from bench import steps
from bench.drives import ROOT
from bench.tables import OUT, Check, Table, publish
from calm_edge.recording.reader import Recording
from calm_edge.recording.sequence_folder import ORIGIN_NS, SequenceFolder
from calm_edge.types import Float, Int
from device.frame import Eye, Frame

COLUMNS = (
    "drive",
    "offset error ms",
    "sigma ms",
    "drift error ppm",
    "sigma ppm",
    "ATE m folder",
    "ATE m videos",
)
LARGEST_ERROR_MS, LARGEST_RATIO = 5.0, 1.2
MISSING_EVERY = 6
CLOCK_HZ = 90_000


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("folder", type=Path, nargs="+", help="sequence folders, with poses0.txt")
    parser.add_argument("--spacing-m", type=float, default=0.55, metavar="X")
    parser.add_argument("--later-s", type=float, default=3.7, help="start of the assistant's clock")
    parser.add_argument("--ppm", type=float, default=0.0, help="by which its clock is slow")
    parser.add_argument("--codec", default="libx264")
    parser.add_argument("--clock-only", action="store_true", help="without the trajectories")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Import each folder, print and save the table; 1 if a requirement is not met."""
    rows, checks = [], []
    for folder in options.folder:
        place = ROOT / "build" / "imported" / folder.name
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        drive = filmed(folder, place, options)
        clock = relation(drive, place, options)
        checks.append(_clock_check(folder.name, clock[0]))
        ate: tuple[float | None, float | None] = (None, None)
        if not options.clock_only:
            ate = trajectories(folder, drive, place, options)
            checks.append(_ate_check(folder.name, *ate))
        rows.append((folder.name, *clock, *ate))
    title = "Two videos against the folder they are made of"
    table = Table("imported", title, options.command, COLUMNS, tuple(rows), tuple(checks))
    return publish(table, options.out)


def _clock_check(name: str, error_ms: float) -> Check:
    within = abs(error_ms) <= LARGEST_ERROR_MS
    return Check(f"{name}: clock offset", f"<= {LARGEST_ERROR_MS:g} ms", error_ms, within)


def _ate_check(name: str, folder: float | None, videos: float | None) -> Check:
    ratio = videos / folder if folder and videos else None
    met = ratio is not None and ratio <= LARGEST_RATIO
    return Check(f"{name}: ATE", f"<= {LARGEST_RATIO:g} times the folder's", ratio, met)


@dataclass(frozen=True, slots=True)
class Filmed:
    """Two videos, and the true times (N,) ns of their pictures on the primary's clock.

    kept: numbers of the folder's pictures, an array for each eye.
    """

    videos: tuple[Path, Path]
    kept: tuple[Int, Int]
    true_ns: tuple[Int, Int]


def filmed(folder: Path, place: Path, options: argparse.Namespace) -> Filmed:
    """Write both videos of a sequence folder to `place`."""
    sequence = SequenceFolder(folder)
    start = int(sequence.t_ns(Eye.PRIMARY)[0])
    true = [sequence.t_ns(eye) - start for eye in Eye]
    n = len(true[1])
    seen = (np.arange(n) % MISSING_EVERY != MISSING_EVERY - 1) & (true[1] >= 1e9 * options.later_s)
    kept = np.arange(len(true[0])), np.flatnonzero(seen)
    true_ns = true[0][kept[0]], true[1][kept[1]]
    own = (true_ns[1] - true_ns[1][0]) * (1 - 1e-6 * options.ppm)
    videos = place / "front.mp4", place / "side.mp4"
    _write(videos[0], sequence, Eye.PRIMARY, kept[0], true_ns[0] / 1e9, options.codec)
    _write(videos[1], sequence, Eye.ASSISTANT, kept[1], own / 1e9, options.codec)
    return Filmed(videos, kept, true_ns)


def _write(
    path: Path, sequence: SequenceFolder, eye: Eye, kept: Int, t_s: Float, codec: str
) -> None:
    """Encode an eye's pictures; the assistant's upside down, with its rotation in the file."""
    wanted = set(kept.tolist())
    frames = (f for k, f in enumerate(sequence.frames(eye)) if k in wanted)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, options={"crf": "18"})
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = sequence.size(eye)
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
        if eye is Eye.ASSISTANT:
            stream.set_display_rotation(180)
        for t, frame in zip(t_s, frames, strict=True):
            made = av.VideoFrame.from_ndarray(_picture(frame), format="bgr24")
            made.pts, made.time_base = round(CLOCK_HZ * t), Fraction(1, CLOCK_HZ)
            container.mux(stream.encode(made))
        container.mux(stream.encode(None))


def _picture(frame: Frame) -> NDArray[np.uint8]:
    picture = frame.bgr()
    if frame.eye is Eye.ASSISTANT:
        picture = np.asarray(cv2.rotate(picture, cv2.ROTATE_180), np.uint8)
    return picture


def relation(
    drive: Filmed, place: Path, options: argparse.Namespace
) -> tuple[float, float, float, float]:
    """Import the videos: error and sigma of the clock offset [ms] and of the drift [ppm]."""
    out = place / "recording"
    videos = map(str, drive.videos)
    spacing = f"{options.spacing_m:g}"
    steps.calm_edge("import", *videos, "--out", str(out), "--spacing-m", spacing)
    recording = Recording(out)
    found = recording.frame_times(Eye.ASSISTANT) - ORIGIN_NS
    facts = recording.import_facts
    error_ms = float(np.median(found - drive.true_ns[1])) / 1e6
    sigma_ms = 1e3 * float(facts["clock_offset_sigma_s"])
    drift = 1e6 * float(facts["clock_drift"]) - options.ppm
    return error_ms, sigma_ms, drift, 1e6 * float(facts["clock_drift_sigma"])


def trajectories(
    folder: Path, drive: Filmed, place: Path, options: argparse.Namespace
) -> tuple[float | None, float | None]:
    """ATE [m] of the same pictures recorded from a folder with true stamps, and of the videos."""
    sequence = _same_pictures(folder, drive, place / "folder")
    spacing = ("--spacing-m", f"{options.spacing_m:g}")
    steps.record(sequence, place / "of_folder", spacing)
    replay = ("--replay", str(place / "recording"), "--pace", "lockstep")
    out = place / "of_videos"
    steps.calm_edge("record", *replay, "--out", str(out), *spacing, accept=(0, 3))
    found = [steps.figures(place / name, sequence) for name in ("of_folder", "of_videos")]
    return found[0].get("ate_se3_m"), found[1].get("ate_se3_m")


def _same_pictures(folder: Path, drive: Filmed, out: Path) -> Path:
    """Sequence folder of links to the pictures that are in the videos, with true stamps."""
    for eye in Eye:
        (out / f"cam{int(eye)}").mkdir(parents=True)
        files = sorted((folder / f"cam{int(eye)}").iterdir())
        for k in drive.kept[eye].tolist():
            (out / f"cam{int(eye)}" / files[k].name).symlink_to(files[k].resolve())
        seconds = (f"{t / 1e9:.9f}\n" for t in drive.true_ns[eye].tolist())
        (out / f"times{int(eye)}.txt").write_text("".join(seconds))
    for name in ("poses0.txt", "calib.txt"):
        (out / name).symlink_to((folder / name).resolve())
    return out
