from __future__ import annotations

import errno

import pytest

from device.clock import ManualClock
from device.drivers.v4l2_device import VideoDevice, VideoNode, find, list_devices
from device.errors import CameraError
from device.frame import Eye
from tests.device.fake_video import JPEG, FakeCamera, FakeVideoIO

METADATA_CAPS = 0x04A00000
STREAMON, S_PARM, S_FMT = 0x12, 0x16, 0x05


def system(**cameras: FakeCamera) -> FakeVideoIO:
    return FakeVideoIO(ManualClock(), {f"/dev/{name}": c for name, c in cameras.items()})


def opened(camera: FakeCamera, rate_hz: float = 10.0) -> tuple[FakeVideoIO, VideoDevice]:
    io = system(video0=camera)
    return io, VideoDevice(io, find("", Eye.PRIMARY, io), 1280, 720, rate_hz)


def refusal(camera: FakeCamera) -> str:
    """What opening says, having left no descriptor open."""
    io = system(video0=camera)
    node = VideoNode("/dev/video0", "Fake", "fake", camera.bus_info)
    with pytest.raises(CameraError) as caught:
        VideoDevice(io, node, 1280, 720, 10.0)
    assert not io.open_fds
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_list_knows_cameras_from_metadata_nodes() -> None:
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


def test_an_old_driver_without_device_caps_is_judged_by_its_capabilities() -> None:
    assert list_devices(system(video0=FakeCamera("a", capabilities=0x04000001, device_caps=0)))
    assert not list_devices(system(video0=FakeCamera("a", capabilities=0x04000002)))


def test_two_sensors_on_one_bus_have_two_addresses() -> None:
    io = system(video0=FakeCamera("usb-1", card="Colour"), video2=FakeCamera("usb-1", card="IR"))
    assert [n.address for n in list_devices(io)] == ["usb-1", "usb-1#1"]
    assert find("usb-1#1", Eye.PRIMARY, io).card == "IR"
    assert find("/dev/video2", Eye.PRIMARY, io).address == "usb-1#1"


def test_permission_denied_names_the_group_unless_a_camera_is_usable() -> None:
    denied = FakeCamera("usb-1", open_errno=errno.EACCES)
    with pytest.raises(CameraError, match=r"/dev/video0: permission denied; .*group video"):
        list_devices(system(video0=denied))
    assert len(list_devices(system(video0=denied, video1=FakeCamera("usb-2")))) == 1


def test_an_empty_address_takes_cameras_by_bus_whatever_their_numbers() -> None:
    io = system(video0=FakeCamera("usb-2"), video1=FakeCamera("usb-1"))
    assert find("", Eye.PRIMARY, io).address == "usb-1"
    assert find("", Eye.ASSISTANT, io).address == "usb-2"


def test_a_missing_camera_is_one_line_with_what_is_there() -> None:
    io = system(video0=FakeCamera("usb-1"))
    with pytest.raises(CameraError, match=r"assistant camera v4l2:usb-9: not there; found: usb-1"):
        find("usb-9", Eye.ASSISTANT, io)
    with pytest.raises(CameraError, match=r"assistant camera .*1 found .*plug in camera 2"):
        find("", Eye.ASSISTANT, io)
    with pytest.raises(CameraError, match="no camera at all"):
        find("usb-9", Eye.PRIMARY, system())


def test_mjpeg_is_preferred_and_the_rate_is_asked_for() -> None:
    camera = FakeCamera("usb-1")
    _, device = opened(camera, rate_hz=7.5)
    assert camera.asked["format"] == ("MJPG", 1280, 720)
    assert device.rate_hz == 7.5
    assert camera.asked["rate"] == (1000, 7500)


def test_yuyv_where_there_is_no_mjpeg_at_the_size_the_camera_settled_on() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("NV12", "YUYV"), size=(640, 480), stride=1408))
    form = device.format
    assert (form.fourcc, form.width_px, form.height_px) == ("YUYV", 640, 480)
    assert form.stride_bytes == 1408


def test_a_format_that_is_listed_but_not_granted_is_not_taken_for_granted() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("MJPG", "YUYV"), refused=("MJPG",)))
    assert device.format.fourcc == "YUYV"


def test_unknown_formats_are_listed() -> None:
    text = refusal(FakeCamera("usb-1", fourccs=("NV12", "H264")))
    assert "NV12, H264" in text and "MJPEG or YUYV" in text


def test_a_camera_without_a_choice_of_rate_is_used_as_it_is() -> None:
    _, device = opened(FakeCamera("usb-1", fails={S_PARM: errno.ENOTTY}))
    assert device.rate_hz == 0


@pytest.mark.parametrize(
    ("number", "code", "words"),
    [
        (STREAMON, errno.ENOSPC, "USB bandwidth"),
        (S_FMT, errno.EBUSY, "in use by another program"),
        (STREAMON, errno.EIO, "Input/output error"),
        (S_PARM, errno.EIO, "Input/output error"),
    ],
)
def test_faults_while_opening_are_explained(number: int, code: int, words: str) -> None:
    text = refusal(FakeCamera("usb-1", fails={number: code}))
    assert words in text and "usb-1" in text and "/dev/video0" in text


def test_permission_denied_while_opening_names_the_group() -> None:
    assert "group video" in refusal(FakeCamera("usb-1", open_errno=errno.EACCES))


def test_every_buffer_goes_back_to_the_driver() -> None:
    camera = FakeCamera("usb-1")
    _, device = opened(camera)
    camera.film(0, 12, 1)
    filled = [device.dequeue(1.0) for _ in range(12)]
    assert [f and f[1] for f in filled] == [JPEG % k for k in range(12)]
    assert len(camera.queued) == 4


def test_close_stops_the_stream_frees_the_buffers_and_may_be_repeated() -> None:
    camera = FakeCamera("usb-1")
    io, device = opened(camera)
    device.close()
    device.close()
    assert not camera.streaming and not camera.memory and not io.open_fds


def test_close_survives_a_camera_that_is_gone() -> None:
    camera = FakeCamera("usb-1")
    io, device = opened(camera)
    camera.gone = True
    device.close()
    assert not io.open_fds
