import cv2
import numpy as np
import pytest

from device.frame import Eye, Frame, UnreadableImage, jpeg

PIXELS = cv2.GaussianBlur(
    np.random.default_rng(0).integers(0, 255, (40, 64, 3), np.uint8), (9, 9), 0
)


def test_a_cameras_own_bytes_are_untouched():
    frame = Frame(Eye.ASSISTANT, 3, 7, b"own")
    assert frame.encoded(50) is frame


def test_pixels_become_a_jpeg_of_the_asked_quality():
    frame = Frame(Eye.PRIMARY, 1, 7, PIXELS)
    encoded = frame.encoded(77)
    expected = cv2.imencode(".jpg", PIXELS, [cv2.IMWRITE_JPEG_QUALITY, 77])[1].tobytes()
    assert encoded == Frame(Eye.PRIMARY, 1, 7, expected)
    assert len(jpeg(PIXELS, 30)) < len(expected) < len(jpeg(PIXELS, 95))
    assert np.abs(encoded.bgr().astype(int) - PIXELS).mean() < 6


def test_a_jpeg_is_decoded_at_an_eighth_of_its_size():
    frame = Frame(Eye.PRIMARY, 0, 0, PIXELS)
    for each in (frame, frame.encoded()):
        assert each.gray().shape == (40, 64) and each.gray(8).shape == (5, 8)


def test_bytes_that_are_no_picture_are_named():
    with pytest.raises(UnreadableImage, match="primary frame 9"):
        Frame(Eye.PRIMARY, 9, 0, b"none").bgr()
