"""Findings on cameras, hubs, permissions and ports."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from calm_edge.commands import plugged_in
from calm_edge.commands.finding import Level
from calm_edge.config import Config, merge
from device.camera import FoundCamera
from device.usb_place import UsbPlace

LEFT = FoundCamera("v4l2:usb-1", "Left", "/dev/video0", "A7")
RIGHT = FoundCamera("v4l2:usb-2", "Right", "/dev/video2", note="in use by ffmpeg; close it")
INFRARED = FoundCamera("v4l2:usb-1#1", "Left", "/dev/video1", by_name_only=True)


def lines(config: Config, *cameras: FoundCamera, errors: tuple[str, ...] = ()) -> str:
    return "\n".join(f.line() for f in plugged_in.cameras(config, cameras, errors))


def test_without_cameras_it_is_said_what_to_plug_in() -> None:
    text = lines(Config(), errors=("v4l2: permission denied",))
    assert "note  cameras: v4l2: permission denied" in text
    assert "none found: only replays" in text and "plug in two USB cameras" in text


def test_every_camera_has_a_line_and_one_is_not_enough() -> None:
    text = lines(Config(), LEFT, INFRARED)
    assert "ok    camera: v4l2:usb-1, Left, /dev/video0" in text
    assert "one found, two are needed; plug in the second" in text
    text = lines(Config(), LEFT, RIGHT)
    assert "note  camera: v4l2:usb-2, Right, /dev/video2; in use by ffmpeg" in text
    assert "needed" not in text


@pytest.mark.parametrize(
    ("address", "is_there"),
    [
        ("v4l2:", True),
        ("v4l2:usb-2", True),
        ("v4l2:/dev/video0", True),
        ("v4l2:serial=A7", True),
        ("v4l2:usb-3", False),
        ("oak:X/CAM_B", True),
    ],
)
def test_a_configured_camera_that_is_not_plugged_in_is_a_failure(
    address: str, is_there: bool
) -> None:
    config = merge(Config(), {"capture": {"assistant": address}})
    assert ("fail  capture.assistant" in lines(config, LEFT, RIGHT)) is not is_there


@pytest.mark.parametrize(
    ("second", "level", "words"),
    [
        (UsbPlace(1, "1-2", 480), Level.NOTE, "share the hub 1-2"),
        (UsbPlace(1, "1-3", 480), Level.GOOD, "on bus 1"),
        (UsbPlace(3, "", 480), Level.GOOD, "different buses"),
    ],
)
def test_a_shared_hub_is_a_note(second: UsbPlace, level: Level, words: str) -> None:
    (found,) = plugged_in.shared_hubs({"a": UsbPlace(1, "1-2", 480), "b": second, "c": None})
    assert found.level is level and words in found.text


def test_cameras_at_the_computer_itself_share_no_hub() -> None:
    (found,) = plugged_in.shared_hubs({"a": UsbPlace(1, "", 480), "b": UsbPlace(1, "", 480)})
    assert found.level is Level.GOOD


def test_a_node_that_may_not_be_used_names_the_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (nothing,) = plugged_in.permissions(Config(), tmp_path)
    assert nothing.level is Level.GOOD and "no camera" in nothing.text
    for name in ("video0", "ttyUSB0"):
        (tmp_path / name).touch()
    (fine,) = plugged_in.permissions(Config(), tmp_path)
    assert fine.level is Level.GOOD and "all 2" in fine.text
    # root may use everything
    monkeypatch.setattr(os, "access", lambda path, mode: "ttyUSB" not in str(path))
    (denied,) = plugged_in.permissions(Config(), tmp_path)
    assert denied.level is Level.NOTE and "ttyUSB0" in denied.text
    assert "usermod -aG dialout" in denied.remedy


def test_the_serial_port_is_there_or_not(tmp_path: Path) -> None:
    def of(port: str) -> tuple[Level, str]:
        found = plugged_in.serial(merge(Config(), {"pose_output": {"port": port}}))
        return found.level, found.line()

    assert of("")[0] is of("udp:localhost:14550")[0] is Level.GOOD
    level, text = of(str(tmp_path / "ttyUSB0"))
    assert level is Level.NOTE and "is not there" in text and "ls /dev/calm-edge" in text
    (tmp_path / "ttyUSB0").touch()
    assert of(str(tmp_path / "ttyUSB0"))[0] is Level.GOOD


def test_the_receiver_is_there_or_not(tmp_path: Path) -> None:
    for source, level in (("", Level.GOOD), ("gpsd", Level.GOOD), ("gpsd:car:2947", Level.GOOD)):
        assert plugged_in.gps(merge(Config(), {"gps": {"source": source}})).level is level
    found = plugged_in.gps(merge(Config(), {"gps": {"source": str(tmp_path / "ttyACM0")}}))
    assert found.level is Level.NOTE and "no fixes are recorded" in found.text
