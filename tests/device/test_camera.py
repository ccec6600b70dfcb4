from __future__ import annotations

import pytest

from device.camera import DRIVERS, CameraSpec, open_camera, parse_address
from device.drivers.replay import ReplayCamera
from device.errors import CameraError
from device.frame import Eye
from tests.manual_clock import ManualClock


def test_open_camera_passes_options_to_the_driver() -> None:
    camera = open_camera(CameraSpec(Eye.PRIMARY, "replay"), ManualClock(), frames=[])
    assert isinstance(camera, ReplayCamera)


def test_unknown_driver_error_lists_the_drivers() -> None:
    with pytest.raises(CameraError) as caught:
        open_camera(CameraSpec(Eye.ASSISTANT, "webcam", "0"), ManualClock())
    text = str(caught.value)
    assert "\n" not in text and "assistant" in text and "'webcam'" in text
    assert all(name in text for name in DRIVERS)
    with pytest.raises(CameraError, match="use one of oak, replay, v4l2"):
        parse_address("webcam:0")


def test_colons_within_an_address_are_kept() -> None:
    assert parse_address("v4l2:usb-0000:00:14.0-1") == ("v4l2", "usb-0000:00:14.0-1")
    assert parse_address("v4l2:") == ("v4l2", "")
