from __future__ import annotations

import errno

import pytest

from device.drivers.v4l2_device import VideoDevice
from device.drivers.v4l2_nodes import VideoNode, find
from device.errors import CameraError
from device.frame import Eye
from tests.device.fake_video import JPEG, FakeCamera, FakeVideoIO, system

STREAMON, S_PARM, S_FMT = 0x12, 0x16, 0x05


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


def test_mjpeg_is_preferred_and_the_rate_is_asked_for() -> None:
    camera = FakeCamera("usb-1")
    _, device = opened(camera, rate_hz=7.5)
    assert camera.asked["format"] == ("MJPG", 1280, 720)
    assert device.rate_hz == 7.5
    assert camera.asked["rate"] == (1000, 7500)


@pytest.mark.parametrize(
    ("asked_hz", "interval"), [(10.0, (1, 15)), (15.0, (1, 15)), (29.97, (1, 30)), (60.0, (1, 30))]
)
def test_the_slowest_rate_that_is_fast_enough_is_taken(
    asked_hz: float, interval: tuple[int, int]
) -> None:
    camera = FakeCamera("usb-1", intervals=((1, 30), (1, 5), (1, 15)))
    _, device = opened(camera, rate_hz=asked_hz)
    over, per = camera.asked["rate"]  # type: ignore[misc]
    assert per / over == interval[1] / interval[0] == device.rate_hz


def test_any_rate_between_two_ends_is_asked_for_as_it_is() -> None:
    camera = FakeCamera("usb-1", intervals=((1, 60), (1, 2)), stepwise=True)
    assert opened(camera, rate_hz=12.5)[1].rate_hz == 12.5
    assert opened(camera, rate_hz=90.0)[1].rate_hz == 60.0


def test_nv12_where_there_is_nothing_better() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("H264", "GREY", "NV12")))
    assert device.format.fourcc == "NV12"


def test_yuyv_where_there_is_no_mjpeg_at_the_size_the_camera_settled_on() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("NV12", "YUYV"), size=(640, 480), stride=1408))
    form = device.format
    assert (form.fourcc, form.width_px, form.height_px) == ("YUYV", 640, 480)
    assert form.stride_bytes == 1408


def test_a_format_that_is_listed_but_not_granted_is_not_taken_for_granted() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("MJPG", "YUYV"), refused=("MJPG",)))
    assert device.format.fourcc == "YUYV"


def test_unknown_formats_are_listed() -> None:
    text = refusal(FakeCamera("usb-1", fourccs=("pRAA", "H264")))
    assert "pRAA, H264" in text and "MJPG, JPEG, YUYV" in text


def test_a_camera_without_a_choice_of_rate_is_used_as_it_is() -> None:
    _, device = opened(FakeCamera("usb-1", fails={S_PARM: errno.ENOTTY}))
    assert device.rate_hz == 0


@pytest.mark.parametrize(
    ("number", "code", "words"),
    [
        (STREAMON, errno.ENOSPC, "USB bandwidth"),
        (S_FMT, errno.EBUSY, "in use by another program"),
        (STREAMON, errno.EPROTO, "Protocol error"),
        (STREAMON, errno.EIO, "Input/output error"),
        (S_PARM, errno.EIO, "Input/output error"),
    ],
)
def test_faults_while_opening_are_explained(number: int, code: int, words: str) -> None:
    text = refusal(FakeCamera("usb-1", fails={number: code}))
    assert words in text and "usb-1" in text and "/dev/video0" in text


def test_a_busy_camera_names_who_holds_it() -> None:
    held_by = ["cheese (process 4711)", "obs (process 12)"]
    text = refusal(FakeCamera("usb-1", fails={S_FMT: errno.EBUSY}, held_by=held_by))
    assert text.endswith("in use by cheese (process 4711), obs (process 12); close it")


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
