from __future__ import annotations

import errno
import os

import pytest

from device.drivers.v4l2_nodes import discover, explain, find, identity, list_devices
from device.errors import CameraError
from device.frame import Eye
from tests.device.fake_video import FakeCamera, Knob, system

METADATA_CAPS = 0x04A00000


def test_metadata_nodes_are_not_listed() -> None:
    io = system(
        video0=FakeCamera("usb-1", card="Left"),
        video1=FakeCamera("usb-1", device_caps=METADATA_CAPS),
        video2=FakeCamera("usb-2", card="Right"),
        video3=FakeCamera("usb-2", device_caps=METADATA_CAPS),
    )
    nodes = list_devices(io)
    assert [(n.path, n.card, n.address) for n in nodes] == [
        ("/dev/video0", "Left", "usb-1"),
        ("/dev/video2", "Right", "usb-2"),
    ]
    assert not io.open_fds


def test_without_device_caps_the_capabilities_are_used() -> None:
    assert list_devices(system(video0=FakeCamera("a", capabilities=0x04000001, device_caps=0)))
    assert not list_devices(system(video0=FakeCamera("a", capabilities=0x04000002)))


def test_two_sensors_on_one_bus_have_two_addresses() -> None:
    io = system(video0=FakeCamera("usb-1", card="Colour"), video2=FakeCamera("usb-1", card="IR"))
    assert [n.address for n in list_devices(io)] == ["usb-1", "usb-1#1"]
    assert find("usb-1#1", Eye.PRIMARY, io).card == "IR"
    assert find("/dev/video2", Eye.PRIMARY, io).address == "usb-1#1"


def infrared(bus: str = "usb-1") -> FakeCamera:
    """The second sensor of a webcam for face recognition."""
    return FakeCamera(bus, card="Webcam", fourccs=("YUYV",), sizes=((340, 340),))


def webcam(bus: str = "usb-1") -> FakeCamera:
    return FakeCamera(bus, card="Webcam", sizes=((640, 480), (1280, 720)))


def test_an_infrared_sensor_is_no_second_camera() -> None:
    io = system(video0=webcam(), video2=infrared())
    with pytest.raises(CameraError, match=r"1 found \(usb-1, usb-1#1 .*infrared\).*; plug in"):
        find("", Eye.ASSISTANT, io)
    io = system(video0=webcam(), video2=infrared(), video4=webcam("usb-2"))
    assert find("", Eye.PRIMARY, io).address == "usb-1"
    assert find("", Eye.ASSISTANT, io).address == "usb-2"
    # by name it is opened
    assert find("usb-1#1", Eye.ASSISTANT, io).path == "/dev/video2"
    assert [camera.by_name_only for camera in discover(io)] == [False, True, False]
    assert "infrared" in discover(io, details=False)[1].note and not io.open_fds


def test_two_equal_sensors_of_one_device_are_two_cameras() -> None:
    io = system(video0=webcam(), video2=webcam())
    assert find("", Eye.ASSISTANT, io).address == "usb-1#1"
    assert not any(camera.by_name_only for camera in discover(io))


def test_a_sensor_that_cannot_be_asked_is_no_second_camera() -> None:
    silent = FakeCamera("usb-1", fails={0x02: errno.EIO})
    io = system(video0=webcam(), video2=silent)
    with pytest.raises(CameraError, match="1 found"):
        find("", Eye.ASSISTANT, io)


def test_multiplanar_nodes_are_listed_with_the_remedy() -> None:
    io = system(
        video0=FakeCamera("platform:isp", card="isp", device_caps=0x04001000),
        video1=FakeCamera("usb-1"),
    )
    first, second = discover(io)
    assert "multi-planar" in first.note and "v4l2loopback" in first.note and first.by_name_only
    assert not second.note
    for address in ("platform:isp", "/dev/video0"):
        with pytest.raises(CameraError, match=r"/dev/video0 has only multi-planar .* USB camera"):
            find(address, Eye.PRIMARY, io)
    with pytest.raises(CameraError, match=r"1 found \(platform:isp has only multi-planar"):
        find("", Eye.ASSISTANT, io)


def test_a_device_open_for_both_cameras_names_the_keys() -> None:
    error = OSError(errno.EBUSY, "busy")
    text = str(explain("camera usb-1", error, [f"calm-edge (process {os.getpid()})"]))
    assert "used for both cameras" in text and "capture.assistant" in text
    assert "in use by cheese" in str(explain("camera usb-1", error, ["cheese (process 1)"]))


def test_permission_denied_names_the_group_unless_a_camera_is_usable() -> None:
    denied = FakeCamera("usb-1", open_errno=errno.EACCES)
    with pytest.raises(CameraError, match=r"/dev/video0: permission denied; .*group video"):
        list_devices(system(video0=denied))
    assert len(list_devices(system(video0=denied, video1=FakeCamera("usb-2")))) == 1


def test_an_empty_address_takes_cameras_in_order_of_bus() -> None:
    io = system(video0=FakeCamera("usb-2"), video1=FakeCamera("usb-1"))
    assert find("", Eye.PRIMARY, io).address == "usb-1"
    assert find("", Eye.ASSISTANT, io).address == "usb-2"


def test_the_error_for_a_missing_camera_lists_those_found() -> None:
    io = system(video0=FakeCamera("usb-1"))
    with pytest.raises(
        CameraError, match=r"assistant camera v4l2:usb-9: not found; plugged in: usb-1"
    ):
        find("usb-9", Eye.ASSISTANT, io)
    with pytest.raises(CameraError, match=r"assistant camera .*1 found .*plug in camera 2"):
        find("", Eye.ASSISTANT, io)
    with pytest.raises(CameraError, match="no camera at all"):
        find("usb-9", Eye.PRIMARY, system())


def test_two_sensors_keep_their_addresses_when_node_numbers_swap() -> None:
    colour = FakeCamera("usb-1", card="Colour", port="1-1:1.0")
    infrared = FakeCamera("usb-1", card="IR", port="1-1:1.2")
    for io in (system(video0=colour, video2=infrared), system(video0=infrared, video2=colour)):
        assert find("usb-1", Eye.PRIMARY, io).card == "Colour"
        assert find("usb-1#1", Eye.PRIMARY, io).card == "IR"


def test_a_camera_is_found_by_its_serial_on_any_port() -> None:
    io = system(video0=FakeCamera("usb-1", serial="A7"), video3=FakeCamera("usb-9", serial="B2"))
    node = find("serial=B2", Eye.PRIMARY, io)
    assert (node.path, node.address, node.serial) == ("/dev/video3", "usb-9", "B2")
    assert identity("serial=B2", node) == "serial=B2"
    assert identity("/dev/video3", node) == identity("", node) == "usb-9"
    with pytest.raises(CameraError, match=r"v4l2:serial=C: not found; plugged in: usb-1, usb-9"):
        find("serial=C", Eye.PRIMARY, io)


def test_a_serial_of_two_cameras_is_ambiguous() -> None:
    io = system(video0=FakeCamera("usb-1", serial="001"), video1=FakeCamera("usb-2", serial="001"))
    with pytest.raises(CameraError, match=r"2 cameras have this serial; .*ports: usb-1, usb-2"):
        find("serial=001", Eye.PRIMARY, io)
    nameless = system(video0=FakeCamera("usb-1"), video1=FakeCamera("usb-2"))
    with pytest.raises(CameraError, match="not found"):
        find("serial=", Eye.PRIMARY, nameless)


def test_discover_lists_formats_rates_and_controls() -> None:
    camera = FakeCamera(
        "usb-1",
        card="Left",
        serial="A7",
        sizes=((640, 480), (1280, 720)),
        intervals=((1, 5), (1, 30)),
        controls={0x00980913: Knob("Gain", 7, 1, 16), 0x009A0902: Knob("Exposure", 5, flags=1)},
    )
    io = system(video0=camera)
    (found,) = discover(io)
    assert (found.address, found.name, found.serial) == ("v4l2:usb-1", "Left", "A7")
    both = ["640x480 30 Hz", "1280x720 30 Hz"]
    assert found.formats == {"YUYV": both, "MJPG": both}
    # the second control is disabled
    assert found.controls == {"Gain": "7 (1 to 16)"}
    assert not found.note and not io.open_fds


def test_discover_without_details_queries_none() -> None:
    camera = FakeCamera("usb-1", sizes=((640, 480),), fails={0x02: errno.EIO, 0x24: errno.EIO})
    (found,) = discover(system(video0=camera), details=False)
    assert not found.formats and not found.controls and not found.note


def test_a_camera_that_cannot_be_queried_is_listed_with_the_reason() -> None:
    busy = FakeCamera("usb-1", fails={0x02: errno.EBUSY}, held_by=["cheese (process 9)"])
    first, second = discover(system(video0=busy, video1=FakeCamera("usb-2")))
    assert first.note == "/dev/video0: in use by cheese (process 9); close it"
    assert not second.note


def test_a_size_range_is_listed_by_its_ends() -> None:
    camera = FakeCamera(
        "usb-1",
        fourccs=("YUYV",),
        sizes=((16, 16), (1920, 1080)),
        intervals=((1, 60), (1, 1)),
        stepwise=True,
    )
    (found,) = discover(system(video0=camera))
    assert found.formats == {"YUYV": ["16x16 60 Hz", "1920x1080 60 Hz"]}


@pytest.mark.parametrize("code", [errno.EACCES, errno.EPERM])
def test_permission_denied_names_group_and_rules(code: int) -> None:
    text = str(explain("/dev/video0", OSError(code, "no")))
    assert "group video" in text and "deploy/99-calm-edge.rules" in text
