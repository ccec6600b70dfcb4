"""Bags of every storage and encoding: topics by type, stamps of the headers, what lies beside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.bag import Bags
from calm_edge.interchange.bag_pictures import pixels
from calm_edge.interchange.base import Imported, ImportOptions
from calm_edge.recording.sensors import ImuSample
from calm_edge.recording.sequence_folder import ORIGIN_NS
from device.frame import Eye
from device.gps.fix import Fix
from tests.interchange.bags import BASELINE_M, START_NS, K, shown, write_foxglove, write_ros

T = np.arange(5) / 20
WRITERS: dict[str, Callable[[Path], Path]] = {
    "ROS 1": lambda folder: write_ros(folder / "drive.bag", T, ros1=True),
    "ROS 1 raw": lambda folder: write_ros(folder / "drive.bag", T, ros1=True, raw=True),
    "ROS 2 sqlite3": lambda folder: write_ros(folder / "drive", T),
    "ROS 2 sqlite3 raw": lambda folder: write_ros(folder / "drive", T, raw=True),
    "ROS 2 mcap": lambda folder: write_ros(folder / "drive", T, mcap=True),
    "MCAP with ROS 2": lambda folder: next(
        write_ros(folder / "drive", T, mcap=True, raw=True).glob("*.mcap")
    ),
    "MCAP": lambda folder: write_foxglove(folder / "drive.mcap", T),
    "MCAP raw": lambda folder: write_foxglove(folder / "drive.mcap", T, kind="raw"),
    "MCAP json": lambda folder: write_foxglove(folder / "drive.mcap", T, kind="json"),
}


def opened(source: Path, **options: object) -> Imported:
    scratch = source.parent / "scratch"
    scratch.mkdir(exist_ok=True)
    wanted = ImportOptions(**options)  # type: ignore[arg-type]
    return Bags().open((source,), wanted, scratch, lambda text: None)


@pytest.mark.parametrize("written", sorted(WRITERS))
def test_pictures_and_header_stamps_of_both_cameras(tmp_path: Path, written: str) -> None:
    imported = opened(WRITERS[written](tmp_path))
    for eye in Eye:
        frames = list(imported.frames(eye))
        assert [f.t_ns for f in frames] == [START_NS + ORIGIN_NS + round(1e9 * t) for t in T]
        wanted = shown(T, int(eye))
        assert all(
            abs(f.bgr().astype(int) - w).mean() < 3 for f, w in zip(frames, wanted, strict=True)
        )
    assert any("left" in line and "5 pictures" in line for line in imported.took)


@pytest.mark.parametrize("written", ["ROS 1", "ROS 2 sqlite3", "ROS 2 mcap", "MCAP with ROS 2"])
def test_calibration_fixes_and_imu_are_taken_along(tmp_path: Path, written: str) -> None:
    imported = opened(WRITERS[written](tmp_path))
    assert imported.calibration is not None
    assert imported.calibration.spacing_m == pytest.approx(BASELINE_M)
    assert imported.calibration.cameras[0].camera.fx == K[0]
    fixes = [sample for sample in imported.samples if isinstance(sample, Fix)]
    assert [fix.t_ns for fix in fixes] == [START_NS + ORIGIN_NS + round(1e9 * t) for t in T]
    assert fixes[0].lla == (48.5, 9.25, 400.0) and fixes[0].sigma_m == (1.0, 1.0, 1.0)
    imu = [sample for sample in imported.samples if isinstance(sample, ImuSample)]
    assert len(imu) == 4 * len(T) and imu[0].gyro == (0.1, 0.2, 0.3)
    assert imu[0].accel == (0.0, 0.5, 9.8)
    times = [sample.t_ns for sample in imported.samples]
    assert times == sorted(times)
    assert {"/fix: 5 fixes", "/imu: 20 IMU samples"} <= set(imported.took)
    assert any(line.startswith("/spare/fix: 1 fixes") for line in imported.dropped)


def test_several_picture_topics_are_listed(tmp_path: Path) -> None:
    bag = write_foxglove(tmp_path / "a.mcap", T, ("/a", "/b", "/c"))
    with pytest.raises(InterchangeError, match=r"--primary and --assistant: /a .*/b .*/c "):
        opened(bag)
    assert "primary /c" in opened(bag, topics=("/c", "/a")).took[0]
    with pytest.raises(InterchangeError, match="no picture topic '/d'; there are: /a"):
        opened(bag, topics=("/d", "/a"))


def test_one_picture_topic_is_refused_unless_single(tmp_path: Path) -> None:
    bag = write_foxglove(tmp_path / "a.mcap", T, ("/a",))
    with pytest.raises(InterchangeError, match=r"two picture topics are needed.*--single"):
        opened(bag)
    assert opened(bag, single=True).eyes == (Eye.PRIMARY,)


@pytest.mark.parametrize("name", ["a.mcap", "a.bag"])
def test_a_damaged_bag_gives_one_line(tmp_path: Path, name: str) -> None:
    file = tmp_path / name
    whole = (
        write_foxglove(tmp_path / "b.mcap", T)
        if name.endswith("mcap")
        else write_ros(tmp_path / "b.bag", T, ros1=True)
    )
    for size in (0, 100, whole.stat().st_size // 2):
        file.write_bytes(whole.read_bytes()[:size])
        with pytest.raises(InterchangeError, match=rf"{name}: "):
            opened(file)


class Raw:
    """A raw picture of one encoding."""

    def __init__(self, encoding: str, rows: np.ndarray) -> None:
        self.encoding, self.data = encoding, rows.tobytes()
        self.height, self.step = rows.shape[0], rows.strides[0]
        self.width = rows.shape[1]


@pytest.mark.parametrize(
    "encoding", ["rgb8", "bgra8", "mono8", "mono16", "bayer_rggb8", "bayer_grbg8"]
)
def test_encodings_of_raw_pictures(encoding: str) -> None:
    """A picture of one colour, red 200, green 120, blue 40, whatever the encoding."""
    colour = {"r": 200, "g": 120, "b": 40, "a": 255}
    if encoding.startswith("bayer"):
        a, b, c, d = (colour[x] for x in encoding[6:10])
        rows = np.tile(np.array([[a, b], [c, d]], np.uint8), (8, 8))
    elif encoding.startswith("mono"):
        rows = np.full((16, 16), 120 if encoding == "mono8" else 120 << 8, np.uint16)
        rows = rows.astype(np.uint8) if encoding == "mono8" else rows
    else:
        rows = np.tile(np.array([colour[x] for x in encoding[:-1]], np.uint8), (16, 16, 1))
    message = Raw(encoding, rows)
    found = pixels("/a", message, message.data)[4:-4, 4:-4]
    grey = found.ndim == 2
    assert (found == (120 if grey else np.array([40, 120, 200]))).all()


def test_an_unknown_encoding_is_refused_by_name() -> None:
    with pytest.raises(InterchangeError, match="'32FC1'"):
        pixels("/depth", Raw("32FC1", np.zeros((4, 4), np.float32)), b"")
