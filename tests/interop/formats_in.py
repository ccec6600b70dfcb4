"""Sources of every kind, imported by `calm-edge import` and read back by the MCAP library."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from calm_edge.recording.schema import IMAGE_TOPICS
from calm_edge.recording.segment import segment_files
from calm_edge.types import Float
from device.frame import Eye
from tests.interchange import bags, layouts
from tests.interchange.moving import pictures, uneven, write_video
from tests.interop.format_row import Reading, Row, calm_edge

T = np.arange(6) / 10
OFFSET_S, SECONDS = 3.7, 14.0
# of the clock offset of two videos
MOST_OFF_S = 0.005
RAW = {"mcap": True, "raw": True}
Make = Callable[[Path], tuple[list[str | Path], list[Float]]]


def stamps(recording: Path, eye: Eye) -> list[int]:
    """Stamps [ns] of an eye's pictures, by the MCAP library."""
    found = []
    for file in segment_files(recording):
        with file.open("rb") as opened:
            reader = make_reader(opened, decoder_factories=[DecoderFactory()], validate_crcs=True)
            for *_, message in reader.iter_decoded_messages(topics=[IMAGE_TOPICS[eye]]):
                found.append(message.timestamp.ToNanoseconds())
    return found


def imported(make: Make, most_off_s: float = 2e-6) -> Callable[[Path], Reading]:
    """Reader of a source: pictures of each eye, and how far stamps are off the true ones."""

    def read(folder: Path) -> Reading:
        arguments, true = make(folder)
        calm_edge("import", *arguments, "--out", folder / "recording")
        words, agrees = [], True
        for eye, t in zip(Eye, true, strict=False):
            found = np.array(stamps(folder / "recording", eye)) / 1e9
            same = len(found) == len(t)
            off = float(np.abs(found - t).max()) if same else float("inf")
            words.append(f"{eye.name.lower()} {len(found)} of {len(t)}, {1e3 * off:.3f} ms off")
            agrees &= same and off <= most_off_s
        return Reading("mcap (Python)", "; ".join(words), agrees)

    return read


def bag(start_ns: int, write: Callable[[Path], Path]) -> Make:
    """A bag or data set whose pictures have both eyes' stamps at start_ns + T."""
    return lambda folder: ([write(folder)], [start_ns / 1e9 + T] * 2)


def folders(suffix: str) -> Make:
    """A folder for each eye, with stamps in ns as names."""

    def make(folder: Path) -> tuple[list[str | Path], list[Float]]:
        names = [f"{bags.START_NS + round(1e9 * t)}.{suffix}" for t in T]
        for eye in range(2):
            (folder / f"c{eye}").mkdir()
            for name, picture in zip(names, pictures(T + 0.1 * eye), strict=True):
                cv2.imwrite(str(folder / f"c{eye}" / name), picture)
        return [folder / "c0", folder / "c1"], [bags.START_NS / 1e9 + T] * 2

    return make


def phones(folder: Path) -> tuple[list[str | Path], list[Float]]:
    """Two videos of one drive by clocks of their own, the second one upside down."""
    first, second = uneven(29.97, SECONDS, 1), uneven(25.0, SECONDS - OFFSET_S, 2)
    front = write_video(folder / "front.mp4", first, pictures(first))
    shown = pictures(second + OFFSET_S, roll_deg=180.0)
    return [front, write_video(folder / "side.mkv", second, shown)], [first, second + OFFSET_S]


def single(suffix: str, codec: str = "mpeg4") -> Make:
    """One video of a container."""

    def make(folder: Path) -> tuple[list[str | Path], list[Float]]:
        t = np.arange(30) / 25
        return [write_video(folder / f"a.{suffix}", t, pictures(t), codec), "--single"], [t]

    return make


ROWS = [
    Row("two videos", "mp4, mkv; 29.97, 25 /s, 3.7 s apart", imported(phones, MOST_OFF_S)),
    *(
        Row(f"video, {suffix}", f"PyAV, {codec}, --single", imported(single(suffix, codec)))
        for suffix, codec in [
            *(("mp4", "libx264"), ("mov", "mpeg4"), ("mkv", "libx265")),
            *(("avi", "mjpeg"), ("ts", "libx264")),
        ]
    ),
    *(
        Row(f"folders, {suffix}", "OpenCV, names in ns", imported(folders(suffix)))
        for suffix in ("jpg", "png", "tif", "bmp", "webp")
    ),
    *(
        Row(name, "own writer of the published layout", imported(bag(start_ns, write)))
        for name, start_ns, write in (
            ("EuRoC", layouts.START_NS, lambda f: layouts.euroc(f, T)),
            ("KITTI raw", layouts.START_NS, lambda f: layouts.kitti_raw(f, T)),
            ("KITTI odometry", 0, lambda f: layouts.kitti_odometry(f, T)),
        )
    ),
    *(
        Row(name, source, imported(bag(bags.START_NS, write)))
        for name, source, write in (
            ("ROS 1 bag", "rosbags", lambda f: bags.write_ros(f / "a.bag", T, ros1=True)),
            ("ROS 2, sqlite3", "rosbags", lambda f: bags.write_ros(f / "a", T)),
            (
                "ROS 2, MCAP, raw",
                "rosbags",
                lambda f: bags.write_ros(f / "a", T, mcap=True, raw=True),
            ),
            ("Foxglove, protobuf", "mcap", lambda f: bags.write_foxglove(f / "a.mcap", T)),
            ("Foxglove, JSON", "mcap", lambda f: bags.write_foxglove(f / "a.mcap", T, kind="json")),
        )
    ),
]
