"""Rows of calib.txt."""

import pytest

from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.camera_row import camera_row, parsed_camera
from calm_edge.geometry.fisheye import Fisheye


@pytest.mark.parametrize(
    "camera",
    [
        Perspective(500.25, 501.0, 320.5, 120.0, 640, 240),
        Perspective(363.75, 363.0, 274.0, 101.5, 544, 208, (-0.13, 0.02, 0.001, -0.002, 0.01)),
        Fisheye(287.5, 287.5, 267.0, 106.0, 544, 208, (-0.02, 0.004)),
        Fisheye(287.5, 287.5, 267.0, 106.0, 544, 208),
    ],
)
def test_a_camera_is_read_as_written(camera: Camera) -> None:
    assert parsed_camera(camera_row(camera)) == camera


def test_six_numbers_are_a_pinhole() -> None:
    assert parsed_camera("500 501 320 120 640 240\n") == Perspective(500, 501, 320, 120, 640, 240)
    assert camera_row(Perspective(500, 501, 320, 120, 640, 240)) == "500 501 320 120 640 240"


@pytest.mark.parametrize(
    "line",
    [
        "500 501 320 120 640",
        "f 501 320 120 640 240",
        "500 501 320 120 640 240 1",
        "500 501 320 120 640 240 pinhole 0",
        "500 501 320 120 640 240 fisheye 0 0 0 0 0",
        "500 501 320 120 640 240 perspective k1",
    ],
)
def test_a_malformed_row_is_refused(line: str) -> None:
    with pytest.raises(ValueError):
        parsed_camera(line)
