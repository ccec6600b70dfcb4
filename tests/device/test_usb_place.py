"""Where cameras are plugged in, from a made-up sysfs."""

from __future__ import annotations

from pathlib import Path

import pytest

from device.usb_place import UsbPlace, place_of


def plug(sys: Path, node: str, device: str, speed: str = "480") -> None:
    """A video node of the interface of a USB device, as sysfs shows it."""
    interface = sys / "devices/pci0000:00/usb1" / device / f"{device.split('/')[-1]}:1.0"
    interface.mkdir(parents=True)
    (interface.parent / "idVendor").write_text("046d\n")
    (interface.parent / "speed").write_text(f"{speed}\n")
    entry = sys / "class/video4linux" / node
    entry.mkdir(parents=True)
    (entry / "device").symlink_to(interface)


@pytest.mark.parametrize(
    ("device", "place"),
    [
        ("1-2", UsbPlace(1, "", 480.0)),
        ("1-2/1-2.3", UsbPlace(1, "1-2", 480.0)),
        ("1-2/1-2.3/1-2.3.1", UsbPlace(1, "1-2.3", 480.0)),
    ],
)
def test_bus_hub_and_speed_are_those_of_the_device(
    device: str, place: UsbPlace, tmp_path: Path
) -> None:
    plug(tmp_path, "video0", device)
    assert place_of("/dev/video0", tmp_path) == place


def test_an_unknown_speed_and_a_node_that_is_not_on_usb(tmp_path: Path) -> None:
    plug(tmp_path, "video0", "1-2", "unknown")
    assert place_of("/dev/video0", tmp_path) == UsbPlace(1, "", 0.0)
    (tmp_path / "devices/virtual/video4linux").mkdir(parents=True)
    (tmp_path / "class/video4linux/video1").mkdir()
    (tmp_path / "class/video4linux/video1/device").symlink_to(tmp_path / "devices/virtual")
    assert place_of("/dev/video1", tmp_path) is None
    assert place_of("/dev/video2", tmp_path) is None
