from __future__ import annotations

import os
from pathlib import Path

from device.drivers.v4l2_identity import NodeFacts, facts, holders


def usb_device(sys: Path, port: str, node: str, serial: str | None) -> None:
    """A camera as in sysfs, where the node's device is an interface of the USB device."""
    device = sys / "devices/pci0000:00/0000:00:14.0/usb1" / port
    interface = device / f"{port}:1.0"
    interface.mkdir(parents=True)
    for folder, value in ((device.parent, "0000:00:14.0"), (device, serial)):
        (folder / "idVendor").write_text("046d\n")
        if value is not None:
            (folder / "serial").write_text(value + "\n")
    listed = sys / "class/video4linux" / node
    listed.mkdir(parents=True)
    (listed / "device").symlink_to(interface)


def test_the_serial_is_that_of_the_usb_device(tmp_path: Path) -> None:
    usb_device(tmp_path, "1-1", "video0", "E822E13F")
    usb_device(tmp_path, "1-2", "video2", None)
    first, second = facts("/dev/video0", tmp_path), facts("/dev/video2", tmp_path)
    assert first.serial == "E822E13F" and first.port.endswith("usb1/1-1/1-1:1.0")
    # not that of the hub, which has one too
    assert second.serial == "" and second.port.endswith("1-2:1.0")


def test_a_camera_that_is_not_usb_has_no_serial(tmp_path: Path) -> None:
    (tmp_path / "devices/platform/vivid.0").mkdir(parents=True)
    node = tmp_path / "class/video4linux/video0"
    node.mkdir(parents=True)
    (node / "device").symlink_to(tmp_path / "devices/platform/vivid.0")
    got = facts("/dev/video0", tmp_path)
    assert got.serial == "" and got.port.endswith("platform/vivid.0")


def test_an_unknown_node_has_empty_facts(tmp_path: Path) -> None:
    assert facts("/dev/video7", tmp_path) == NodeFacts()


def test_processes_with_the_node_open_are_named(tmp_path: Path) -> None:
    for number, name, target in (
        (7, "cheese", "/dev/video0"),
        (8, "bash", "/dev/video1"),
        (9, "obs", "/dev/video0"),
    ):
        process = tmp_path / str(number)
        (process / "fd").mkdir(parents=True)
        (process / "comm").write_text(name + "\n")
        (process / "fd/0").symlink_to("/dev/null")
        (process / "fd/3").symlink_to(target)
    (tmp_path / "10").mkdir()
    assert holders("/dev/video0", tmp_path) == ["cheese (process 7)", "obs (process 9)"]


def test_processes_without_access_are_skipped(tmp_path: Path) -> None:
    (tmp_path / "11").mkdir()
    (tmp_path / "11/fd").write_text("not a folder, so it cannot be listed")
    assert holders("/dev/video0", tmp_path) == []


def test_the_own_process_is_found(tmp_path: Path) -> None:
    node = tmp_path / "video0"
    node.write_bytes(b"")
    with node.open("rb"):
        assert any(f"(process {os.getpid()})" in who for who in holders(str(node)))
    assert holders(str(node)) == []
