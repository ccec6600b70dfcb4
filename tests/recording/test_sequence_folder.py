"""A folder of images becomes frames, or one error line."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.recording import SequenceError
from calm_edge.recording.sequence_folder import ORIGIN_NS, SequenceFolder, read_times
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


def _no_pictures(drive: Path) -> Path:
    for file in (drive / "cam1").iterdir():
        file.write_text("not a picture")
    return drive


def _backwards(drive: Path) -> Path:
    (drive / "times1.txt").write_text("0.2\n0.1\n0.0\n")
    return drive


def _standing(drive: Path) -> Path:
    (drive / "times0.txt").write_text("0.1\n0.1\n0.1\n")
    return drive


def _words(drive: Path) -> Path:
    (drive / "times0.txt").write_text("0.0\nnoon\n0.1\n")
    return drive


def _apart(drive: Path) -> Path:
    (drive / "times1.txt").write_text("64.0\n64.1\n64.2\n")
    return drive


def _video(drive: Path) -> Path:
    (drive / "front.mp4").write_bytes(b"")
    return drive / "front.mp4"


def _videos(drive: Path) -> Path:
    for eye in range(2):
        for file in (drive / f"cam{eye}").iterdir():
            file.unlink()
        (drive / f"cam{eye}" / "a.MP4").write_bytes(b"")
    return drive


def _recording(drive: Path) -> Path:
    (drive / "0000.mcap").write_bytes(b"")
    return drive / "0000.mcap"


def _recording_folder(drive: Path) -> Path:
    (drive / "cam0").rename(drive / "other")
    return _recording(drive).parent


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
        (_no_pictures, "000000.jpg: not a JPEG"),
        (_backwards, "times1.txt: its times do not increase"),
        (_standing, "times0.txt: its times do not increase"),
        (_words, "times0.txt:2: 'noon'"),
        (_apart, "no time in common: cam0 0.000 to 0.200 s, cam1 64.000 to 64.200 s"),
        (_video, "front.mp4: a file, not a folder of pictures; use calm-edge import"),
        (_videos, "videos or bags, not pictures; use calm-edge import"),
        (_recording, "record --replay"),
        (_recording_folder, "a recording, not a folder of pictures; use record --replay"),
        (_too_few_times, "times1.txt: 2 times for 3 images"),
        (_one_time_file, "times0.txt: missing"),
    ],
)
def test_invalid_folders_raise_one_line(tmp_path: Path, damage, message: str) -> None:
    with pytest.raises(SequenceError) as error:
        SequenceFolder(damage(_drive(tmp_path / "d")))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_truncated_png_raises_where_all_pictures_are_needed(tmp_path: Path) -> None:
    drive = _drive(tmp_path / "d", suffix=".png")
    file = drive / "cam0" / "000001.png"
    file.write_bytes(file.read_bytes()[:-300])
    frames = SequenceFolder(drive).frames(Eye.PRIMARY)
    assert next(frames).sequence == 0
    with pytest.raises(SequenceError, match=r"000001.* truncated; replace it or remove it"):
        next(frames)


@pytest.mark.parametrize("layout", ["mav0/cam{}", "cam{}"])
@pytest.mark.parametrize("listed", [True, False])
def test_the_layout_of_euroc_is_read(tmp_path: Path, layout: str, listed: bool) -> None:
    epoch_ns = 1_403_715_273_262_142_976
    for eye in range(2):
        camera = tmp_path / layout.format(eye)
        (camera / "data").mkdir(parents=True)
        stamps = [epoch_ns + k * 50_000_000 + 7 * eye for k in range(4)]
        for k, t_ns in enumerate(stamps):
            cv2.imwrite(str(camera / "data" / f"{t_ns}.png"), _picture(k))
        if listed:
            rows = "".join(f"{t_ns},{t_ns}.png\r\n" for t_ns in stamps)
            (camera / "data.csv").write_text(f"#timestamp [ns],filename\r\n{rows}")
    folder = SequenceFolder(tmp_path)
    for eye in Eye:
        expected = [ORIGIN_NS + epoch_ns + k * 50_000_000 + 7 * eye for k in range(4)]
        assert folder.t_ns(eye).tolist() == expected
    assert folder.file(Eye.PRIMARY, 2).name == f"{epoch_ns + 100_000_000}.png"
    assert len(folder.notes) == 2 and all("read as ns" in note for note in folder.notes)


def test_pictures_may_change_their_size(tmp_path: Path) -> None:
    drive = _drive(tmp_path / "d")
    cv2.imwrite(str(drive / "cam0" / "000002.jpg"), _picture(5, width=48))
    folder = SequenceFolder(drive)
    widths = [frame.gray().shape[1] for frame in folder.frames(Eye.PRIMARY)]
    assert widths == [40, 40, 48] and folder.size(Eye.PRIMARY) == (40, 24)


def test_times_keep_nanoseconds(tmp_path: Path) -> None:
    file = tmp_path / "times.txt"
    file.write_text("-0.004\n0.000000001\n1234.5\n1234.6\n1234.7\n\n")
    assert read_times(file).tolist() == [
        996_000_000, 1_000_000_001, 1_235_500_000_000, 1_235_600_000_000, 1_235_700_000_000,
    ]  # fmt: skip
