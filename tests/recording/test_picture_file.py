"""Files of one camera become pictures of 8 bits, all turned as the first one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.recording.picture_file import PictureError, PictureFiles
from device.frame import Eye, Frame
from device.jpeg import walk, with_orientation

PIXELS = cv2.GaussianBlur(
    np.random.default_rng(3).integers(0, 255, (24, 40, 3), np.uint8), (3, 3), 0
)


def written(file: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(file), image)
    return file


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif", ".webp", ".ppm"])
def test_other_formats_are_read_as_pixels(tmp_path: Path, suffix: str) -> None:
    file = written(tmp_path / f"a{suffix}", PIXELS)
    files = PictureFiles([file])
    picture = files.read(file)
    assert isinstance(picture, np.ndarray) and picture.dtype == np.uint8
    assert np.abs(picture.astype(int) - PIXELS).max() <= (60 if suffix == ".webp" else 0)
    assert files.size == (40, 24) and files.notes == []


@pytest.mark.parametrize(("bits", "brightest"), [(12, 4095), (12, 2100), (14, 16000), (10, 1000)])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_the_used_ones_of_16_bits_count(
    tmp_path: Path, bits: int, brightest: int, suffix: str
) -> None:
    gray = np.linspace(0, brightest, 24 * 40).reshape(24, 40)
    # the first picture is dark, as at night or under a bridge
    dark = written(tmp_path / f"0{suffix}", (gray / 20).astype(np.uint16))
    bright = [written(tmp_path / f"{k}{suffix}", gray.astype(np.uint16)) for k in (1, 2)]
    files = PictureFiles([dark, *bright])
    picture = files.read(bright[0])
    assert isinstance(picture, np.ndarray) and picture.shape == (24, 40, 3)
    assert np.abs(picture[..., 0] - gray / 2 ** (bits - 8)).max() < 1.0
    assert files.notes == [f"{tmp_path}: the pictures use {bits} of 16 bits"]


def test_all_16_bits_and_those_on_the_left_are_read(tmp_path: Path) -> None:
    gray = np.linspace(0, 65520, 24 * 40).reshape(24, 40).astype(np.uint16)
    for number, values in enumerate((gray, gray & 0xFFF0)):
        files = PictureFiles([written(tmp_path / f"{number}.png", values)])
        picture = files.read(tmp_path / f"{number}.png")
        assert isinstance(picture, np.ndarray) and files.notes == []
        np.testing.assert_array_equal(picture[..., 1], values >> 8)


def turned(file: Path, orientation: int) -> Path:
    data = bytes(cv2.imencode(".jpg", PIXELS)[1])
    file.write_bytes(with_orientation(walk(data), orientation).data)
    return file


@pytest.mark.parametrize(("first", "later"), [(1, 6), (6, 1), (3, 1), (6, 8)])
def test_all_pictures_are_turned_as_the_first(
    tmp_path: Path, first: int, later: int, caplog: pytest.LogCaptureFixture
) -> None:
    paths = [turned(tmp_path / f"{k}.jpg", o) for k, o in enumerate([first, first, later, later])]
    files = PictureFiles(paths)
    frames = [Frame(Eye.PRIMARY, 0, 0, files.read(path)) for path in paths]
    pictures = [frame.bgr() for frame in frames]
    assert all(np.array_equal(picture, pictures[0]) for picture in pictures)
    assert pictures[0].shape[1::-1] == files.size == ((24, 40) if first == 6 else (40, 24))
    assert len(files.notes) == (first != 1)
    (record,) = caplog.records
    assert "2.jpg: EXIF says that the camera was turned" in record.getMessage()


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".webp", ".jpg"])
def test_what_is_no_picture_is_named(
    tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]
) -> None:
    good = written(tmp_path / f"0{suffix}", PIXELS)
    files = PictureFiles([good])
    bad = tmp_path / f"1{suffix}"
    spoilt = [b"", b"not a picture", good.read_bytes()[: 60 if suffix == ".jpg" else -300]]
    for data in spoilt:
        bad.write_bytes(data)
        with pytest.raises(PictureError, match=f"1\\{suffix}: ") as error:
            files.read(bad)
        assert "\n" not in str(error.value)
    with pytest.raises(PictureError, match="cannot be read"):
        files.read(tmp_path / f"absent{suffix}")
    assert capfd.readouterr().err == ""


def test_the_first_readable_file_gives_the_size(tmp_path: Path) -> None:
    bad = tmp_path / "0.jpg"
    bad.write_bytes(b"")
    assert PictureFiles([bad, written(tmp_path / "1.jpg", PIXELS)]).size == (40, 24)
    with pytest.raises(PictureError, match=r"0\.jpg"):
        PictureFiles([bad])


def test_colours_beyond_8_and_16_bits_are_refused(tmp_path: Path) -> None:
    file = written(tmp_path / "a.tif", PIXELS.astype(np.float32))
    with pytest.raises(PictureError, match="float32; convert"):
        PictureFiles([file])


@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp"])
def test_a_picture_with_the_name_of_a_jpeg_is_read(tmp_path: Path, suffix: str) -> None:
    file = written(tmp_path / f"a{suffix}", PIXELS).rename(tmp_path / "a.jpg")
    picture = PictureFiles([file]).read(file)
    assert isinstance(picture, np.ndarray) and picture.shape == PIXELS.shape


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "empty"),
        (b"<html>404</html>", "not a JPEG"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", "git lfs pull"),
    ],
)
def test_why_no_file_is_a_picture_is_said(tmp_path: Path, data: bytes, reason: str) -> None:
    files = [tmp_path / f"{k}.jpg" for k in range(3)]
    for file in files:
        file.write_bytes(data)
    with pytest.raises(PictureError, match=rf"0\.jpg: .*{reason}.*none of the 3 first files"):
        PictureFiles(files)
