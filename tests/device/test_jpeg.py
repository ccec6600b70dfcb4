"""Every way in which a camera or a program spoils a JPEG gives a whole one, or is refused."""

from __future__ import annotations

import struct

import cv2
import numpy as np
import pytest

from device.jpeg import EOI, SOI, JpegError, completed, walk, with_orientation
from device.jpeg_pixels import decode

PIXELS = cv2.GaussianBlur(
    np.random.default_rng(0).integers(0, 255, (48, 72, 3), np.uint8), (5, 5), 0
)


def encoded(*options: int) -> bytes:
    return bytes(cv2.imencode(".jpg", PIXELS, list(options))[1])


PLAIN = encoded()


def opened_by_others(data: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def without_tables(data: bytes) -> bytes:
    at, kept = 2, data[:2]
    while data[at + 1] != 0xDA:
        end = at + 2 + struct.unpack(">H", data[at + 2 : at + 4])[0]
        kept += b"" if data[at + 1] == 0xC4 else data[at:end]
        at = end
    return kept + data[at:]


def with_thumbnail(data: bytes) -> bytes:
    """A JPEG with a smaller one inside of a segment, as cameras write it."""
    small = bytes(cv2.imencode(".jpg", PIXELS[::8, ::8])[1])
    return SOI + struct.pack(">BBH", 0xFF, 0xE1, len(small) + 2) + small + data[2:]


@pytest.mark.parametrize(
    "spoilt",
    [
        PLAIN + bytes(8192),
        PLAIN + b"\0\0\0\x18ftypmp42" + bytes(200_000),
        PLAIN + bytes(cv2.imencode(".jpg", PIXELS[:16])[1]),
        b"\0\xff\xd8junk" + PLAIN,
        PLAIN[: len(PLAIN) // 2] + PLAIN,
        PLAIN[:-2],
        PLAIN[:-2] + bytes(9000),
        PLAIN[:-1],
        PLAIN[:-2] + b"\xff\xff\xff" + EOI,
        PLAIN[:-2] + bytes(3) + EOI,
        PLAIN[:-2] + bytes(500) + EOI,
        without_tables(PLAIN),
        without_tables(PLAIN)[:-2],
        with_thumbnail(PLAIN),
    ],
    ids=["zeros", "mp4", "second", "junk before", "cut, then whole", "no EOI", "no EOI, zeros",
         "half an EOI", "fill", "aligned", "filled up", "no DHT", "no DHT, no EOI", "thumbnail"],
)  # fmt: skip
def test_a_spoilt_jpeg_becomes_whole_and_opens_everywhere(
    spoilt: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    jpeg = walk(spoilt)
    assert jpeg.size == (72, 48) and jpeg.data.startswith(SOI) and jpeg.data.endswith(EOI)
    assert len(jpeg.data) < len(PLAIN) + 2000
    expected = opened_by_others(PLAIN)
    np.testing.assert_array_equal(decode(jpeg), expected)
    assert "rror" not in capfd.readouterr().err
    np.testing.assert_array_equal(opened_by_others(jpeg.data), expected)


def test_a_whole_jpeg_is_not_changed() -> None:
    restarts = encoded(cv2.IMWRITE_JPEG_RST_INTERVAL, 1)
    progressive = encoded(cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
    optimised = encoded(cv2.IMWRITE_JPEG_OPTIMIZE, 1)
    for data in (PLAIN, restarts, progressive, optimised):
        assert completed(data) == data
        np.testing.assert_array_equal(decode(walk(data)), opened_by_others(data))
    assert b"\xff\xd0" in restarts


@pytest.mark.parametrize(
    "data", [b"", b"not a picture", SOI, SOI + EOI, PLAIN[:100], with_thumbnail(PLAIN)[:300]]
)
def test_what_has_no_picture_is_refused(data: bytes) -> None:
    assert completed(data) is None
    with pytest.raises(JpegError, match="not a JPEG"):
        walk(data)


def hurt(data: bytes) -> bytes:
    middle = len(data) // 2
    noise = np.random.default_rng(1).integers(0, 255, 300, np.uint8)
    return data[:middle] + bytes(noise) + data[middle + 300 :]


@pytest.mark.parametrize("data", [PLAIN[: len(PLAIN) // 2], PLAIN[:-60] + EOI, hurt(PLAIN)])
def test_an_incomplete_picture_is_refused_in_silence(
    data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    jpeg = walk(data)
    for gray, reduction in [(False, 1), (True, 1), (True, 2), (True, 8)]:
        with pytest.raises(JpegError, match="damaged JPEG"):
            decode(jpeg, gray=gray, reduction=reduction)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("orientation", range(1, 9))
def test_the_orientation_is_that_of_other_programs(orientation: int) -> None:
    jpeg = with_orientation(walk(PLAIN), orientation)
    assert walk(jpeg.data) == jpeg and jpeg.orientation == orientation
    pixels = decode(jpeg)
    np.testing.assert_array_equal(pixels, opened_by_others(jpeg.data))
    assert jpeg.size == pixels.shape[1::-1]
    changed = with_orientation(jpeg, 9 - orientation)
    assert (
        walk(changed.data).orientation == 9 - orientation and len(changed.data) <= len(PLAIN) + 36
    )


def test_little_endian_exif_is_read_too() -> None:
    tiff = b"Exif\0\0II*\0\x08\0\0\0\x01\0" + struct.pack("<HHII", 0x112, 3, 1, 6) + bytes(4)
    data = SOI + struct.pack(">BBH", 0xFF, 0xE1, len(tiff) + 2) + tiff + PLAIN[2:]
    assert walk(data).orientation == 6 and walk(data).size == (48, 72)
    assert with_orientation(walk(data), 3).data == data.replace(
        b"\x01\0\0\0\x06", b"\x01\0\0\0\x03"
    )
    damaged = walk(data.replace(b"\x06\0\0\0", b"\x63\0\0\0", 1))
    assert damaged.orientation == 1


@pytest.mark.parametrize("reduction", [1, 2, 8])
def test_grey_and_reduced_pixels_are_opencvs(reduction: int) -> None:
    flags = {1: cv2.IMREAD_GRAYSCALE, 2: cv2.IMREAD_REDUCED_GRAYSCALE_2,
             8: cv2.IMREAD_REDUCED_GRAYSCALE_8}  # fmt: skip
    for pixels in (PIXELS, PIXELS[:47, :71], PIXELS[:, :, 0]):
        data = bytes(cv2.imencode(".jpg", pixels)[1])
        expected = cv2.imdecode(np.frombuffer(data, np.uint8), flags[reduction])
        np.testing.assert_array_equal(decode(walk(data), gray=True, reduction=reduction), expected)
