from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from device.drivers.v4l2_ioctl import PixelFormat
from device.drivers.v4l2_pixels import JPEGS, WANTED, decode
from tests.device.fake_video import JPEG

WIDTH, HEIGHT = 32, 16


@pytest.fixture(scope="module")
def picture() -> NDArray[np.uint8]:
    """BGR patches of 8 px, large enough for formats with subsampled chroma."""
    colours = np.random.default_rng(3).integers(40, 216, (HEIGHT // 8, WIDTH // 8, 3))
    return colours.repeat(8, 0).repeat(8, 1).astype(np.uint8)


def encoded(fourcc: str, bgr: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """The planes of the image as sent by a camera, each (rows, bytes)."""
    if fourcc in ("BGR3", "RGB3"):
        return [(bgr if fourcc == "BGR3" else bgr[..., ::-1]).reshape(HEIGHT, -1)]
    if fourcc == "GREY":
        return [np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY), np.uint8)]
    planes = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2YUV_I420), np.uint8)
    luma = planes[:HEIGHT]
    u, v = planes[HEIGHT:].reshape(2, HEIGHT // 2, WIDTH // 2)
    if fourcc == "YU12":
        return [luma, u, v]
    if fourcc == "YV12":
        return [luma, v, u]
    if fourcc in ("NV12", "NV21"):
        first, second = (u, v) if fourcc == "NV12" else (v, u)
        return [luma, np.stack([first, second], -1).reshape(HEIGHT // 2, WIDTH)]
    rows = np.empty((HEIGHT, WIDTH // 2, 4), np.uint8)
    at = {"YUYV": (0, 1, 2, 3), "UYVY": (1, 0, 3, 2), "YVYU": (0, 3, 2, 1)}[fourcc]
    parts = luma[:, 0::2], u.repeat(2, 0), luma[:, 1::2], v.repeat(2, 0)
    for place, part in zip(at, parts, strict=True):
        rows[..., place] = part
    return [rows.reshape(HEIGHT, -1)]


def padded(planes: list[NDArray[np.uint8]], pad: int) -> tuple[bytes, int]:
    """The planes with `pad` bytes of row padding (chroma in proportion), and the stride."""
    full = planes[0].shape[1]
    rows = [np.pad(p, ((0, 0), (0, pad * p.shape[1] // full)), constant_values=99) for p in planes]
    return b"".join(r.tobytes() for r in rows), full + pad


@pytest.mark.parametrize("pad", [0, 16])
@pytest.mark.parametrize("fourcc", [f for f in WANTED if f not in JPEGS])
def test_every_format_decodes_to_the_same_image(
    fourcc: str, pad: int, picture: NDArray[np.uint8]
) -> None:
    data, stride = padded(encoded(fourcc, picture), pad)
    image = decode(data, PixelFormat(fourcc, WIDTH, HEIGHT, stride))
    assert isinstance(image, np.ndarray)
    assert image.shape == (HEIGHT, WIDTH, 3) and image.dtype == np.uint8
    if fourcc == "GREY":
        gray = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        assert (image == gray[..., None]).all()
    else:
        assert np.abs(image.astype(int) - picture.astype(int)).max() <= 4


@pytest.mark.parametrize("fourcc", [f for f in WANTED if f not in JPEGS])
def test_a_buffer_that_is_too_short_is_invalid(fourcc: str, picture: NDArray[np.uint8]) -> None:
    data, stride = padded(encoded(fourcc, picture), 0)
    assert decode(data[:-1], PixelFormat(fourcc, WIDTH, HEIGHT, stride)) is None
    assert decode(data, PixelFormat(fourcc, WIDTH, HEIGHT, stride - 1)) is None


@pytest.mark.parametrize("fourcc", JPEGS)
def test_a_jpeg_is_cut_out_of_the_buffer(fourcc: str) -> None:
    data = JPEG % 7
    for buffer in (data, data + b"padding\0\0", b"\0" + data, data[:-2]):
        assert decode(buffer, PixelFormat(fourcc, WIDTH, HEIGHT, 0)) == data
    for buffer in (b"", data[2:], data[:30], b"\xff\xd8 anything \xff\xd9"):
        assert decode(buffer, PixelFormat(fourcc, WIDTH, HEIGHT, 0)) is None
