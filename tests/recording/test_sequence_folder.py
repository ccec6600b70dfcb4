"""A folder of images becomes frames, or one error line."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.recording.sequence_folder import (
    ORIGIN_NS,
    SequenceError,
    SequenceFolder,
    image_size,
    read_times,
)
from device.frame import Eye


def _picture(seed: int, width: int = 40, height: int = 24) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 255, (height, width, 3)).astype(np.uint8)


def _drive(folder: Path, n: int = 3, suffix: str = ".jpg", times: bool = True) -> Path:
    for eye in range(2):
        (folder / f"cam{eye}").mkdir(parents=True)
        for i in range(n):
            cv2.imwrite(str(folder / f"cam{eye}" / f"{i:06d}{suffix}"), _picture(10 * eye + i))
        if times:
            stamps = "".join(f"{0.1 * i + 0.017 * eye:.6f}\n" for i in range(n))
            (folder / f"times{eye}.txt").write_text(stamps)
    return folder


def test_jpeg_bytes_are_unchanged_and_stamps_shifted(tmp_path: Path) -> None:
    folder = SequenceFolder(_drive(tmp_path / "d"))
    frames = list(folder.frames(Eye.ASSISTANT))
    assert [f.t_ns for f in frames] == [
        ORIGIN_NS + ns for ns in (17_000_000, 117_000_000, 217_000_000)
    ]
    assert [f.sequence for f in frames] == [0, 1, 2]
    assert all(f.eye is Eye.ASSISTANT for f in frames)
    for i, frame in enumerate(frames):
        assert frame.image == (tmp_path / "d" / "cam1" / f"{i:06d}.jpg").read_bytes()
    assert (folder.count(Eye.PRIMARY), folder.size(Eye.PRIMARY)) == (3, (40, 24))


def test_png_is_decoded_to_the_same_pixels(tmp_path: Path) -> None:
    folder = SequenceFolder(_drive(tmp_path / "d", suffix=".png"))
    frames = list(folder.frames(Eye.PRIMARY))
    assert isinstance(frames[1].image, np.ndarray)
    assert np.array_equal(frames[1].image, _picture(1))


def test_without_time_files_the_rate_is_ten_hertz(tmp_path: Path) -> None:
    folder = SequenceFolder(_drive(tmp_path / "d", times=False))
    assert folder.t_ns(Eye.PRIMARY).tolist() == [ORIGIN_NS + k * 100_000_000 for k in range(3)]


def test_ground_truth_is_not_opened(tmp_path: Path) -> None:
    drive = _drive(tmp_path / "d")
    for name in ("poses0.txt", "calib.txt", "cloud.npy"):
        (drive / name).write_bytes(b"\xff not to be read")
    assert len(list(SequenceFolder(drive).frames(Eye.PRIMARY))) == 3


def _no_folder(drive: Path) -> Path:
    return drive / "nowhere"


def _one_camera(drive: Path) -> Path:
    (drive / "cam1").rename(drive / "other")
    return drive


def _empty_camera(drive: Path) -> Path:
    for file in (drive / "cam0").iterdir():
        file.unlink()
    return drive


def _unequal(drive: Path) -> Path:
    cv2.imwrite(str(drive / "cam0" / "000002.jpg"), _picture(5, width=48))
    return drive


def _not_an_image(drive: Path) -> Path:
    (drive / "cam1" / "000001.jpg").write_text("not a picture")
    return drive


def _no_header(drive: Path) -> Path:
    file = drive / "cam1" / "000001.jpg"
    file.write_bytes(file.read_bytes()[:100])
    return drive


def _backwards(drive: Path) -> Path:
    (drive / "times1.txt").write_text("0.0\n0.2\n0.1\n")
    return drive


def _standing(drive: Path) -> Path:
    (drive / "times0.txt").write_text("0.0\n0.1\n0.1\n")
    return drive


def _words(drive: Path) -> Path:
    (drive / "times0.txt").write_text("0.0\nnoon\n0.1\n")
    return drive


def _infinite(drive: Path) -> Path:
    (drive / "times0.txt").write_text("0.0\n0.1\ninf\n")
    return drive


def _too_few_times(drive: Path) -> Path:
    (drive / "times1.txt").write_text("0.0\n0.1\n")
    return drive


def _one_time_file(drive: Path) -> Path:
    (drive / "times0.txt").unlink()
    return drive


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_no_folder, "nowhere: no such folder"),
        (_one_camera, "cam1: missing"),
        (_empty_camera, "cam0: holds no"),
        (_unequal, "000002.jpg: 48x24 px"),
        (_not_an_image, "000001.jpg: not a readable image"),
        (_no_header, "000001.jpg: not a readable image"),
        (_backwards, "times1.txt:3: 0.1 s is not after the line before"),
        (_standing, "times0.txt:3: 0.1 s is not after the line before"),
        (_words, "times0.txt:2: 'noon'"),
        (_infinite, "times0.txt:3: 'inf'"),
        (_too_few_times, "times1.txt: 2 times for 3 images"),
        (_one_time_file, "times0.txt: missing"),
    ],
)
def test_invalid_folders_raise_one_line(tmp_path: Path, damage, message: str) -> None:
    with pytest.raises(SequenceError) as error:
        SequenceFolder(damage(_drive(tmp_path / "d")))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_truncated_image_raises_when_it_is_read(tmp_path: Path, suffix: str) -> None:
    drive = _drive(tmp_path / "d", suffix=suffix)
    file = drive / "cam0" / f"000001{suffix}"
    file.write_bytes(file.read_bytes()[:-300])
    frames = SequenceFolder(drive).frames(Eye.PRIMARY)
    assert next(frames).sequence == 0
    with pytest.raises(SequenceError, match=r"000001.* truncated"):
        next(frames)


@pytest.mark.parametrize("flags", [[], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]])
def test_image_size_reads_baseline_and_progressive_jpeg(tmp_path: Path, flags: list[int]) -> None:
    file = tmp_path / "a.jpg"
    cv2.imwrite(str(file), _picture(0, width=321, height=57), flags)
    assert image_size(file) == (321, 57)


def test_times_keep_nanoseconds(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    file.write_text("-0.004\n0.000000001\n1234.5\n\n")
    assert read_times(file).tolist() == [996_000_000, 1_000_000_001, 1_235_500_000_000]
