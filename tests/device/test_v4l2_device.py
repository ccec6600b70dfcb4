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
    """Error message on opening; checks that no descriptor stays open."""
    io = system(video0=camera)
    node = VideoNode("/dev/video0", "Fake", "fake", camera.bus_info)
    with pytest.raises(CameraError) as caught:
        VideoDevice(io, node, 1280, 720, 10.0)
    assert not io.open_fds
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_mjpeg_is_preferred_and_the_rate_is_requested() -> None:
    camera = FakeCamera("usb-1")
    _, device = opened(camera, rate_hz=7.5)
    assert camera.asked["format"] == ("MJPG", 1280, 720)
    assert device.rate_hz == 7.5
    assert camera.asked["rate"] == (1000, 7500)


@pytest.mark.parametrize(
    ("asked_hz", "interval"), [(10.0, (1, 15)), (15.0, (1, 15)), (29.97, (1, 30)), (60.0, (1, 30))]
)
def test_the_slowest_sufficient_rate_is_chosen(asked_hz: float, interval: tuple[int, int]) -> None:
    camera = FakeCamera("usb-1", intervals=((1, 30), (1, 5), (1, 15)))
    _, device = opened(camera, rate_hz=asked_hz)
    over, per = camera.asked["rate"]  # type: ignore[misc]
    assert per / over == interval[1] / interval[0] == device.rate_hz


def test_any_rate_in_a_continuous_range_is_requested_unchanged() -> None:
    camera = FakeCamera("usb-1", intervals=((1, 60), (1, 2)), stepwise=True)
    assert opened(camera, rate_hz=12.5)[1].rate_hz == 12.5
    assert opened(camera, rate_hz=90.0)[1].rate_hz == 60.0


def test_nv12_is_used_if_nothing_better_is_offered() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("H264", "GREY", "NV12")))
    assert device.format.fourcc == "NV12"


def test_yuyv_is_preferred_to_nv12_at_the_size_the_camera_chose() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("NV12", "YUYV"), size=(640, 480), stride=1408))
    form = device.format
    assert (form.fourcc, form.width_px, form.height_px) == ("YUYV", 640, 480)
    assert form.stride_bytes == 1408


def test_a_listed_format_that_is_not_granted_is_skipped() -> None:
    _, device = opened(FakeCamera("usb-1", fourccs=("MJPG", "YUYV"), refused=("MJPG",)))
    assert device.format.fourcc == "YUYV"


def test_the_error_for_unknown_formats_lists_them() -> None:
    text = refusal(FakeCamera("usb-1", fourccs=("pRAA", "H264")))
    assert "pRAA, H264" in text and "MJPG, JPEG, YUYV" in text


def test_a_camera_without_selectable_rates_is_accepted() -> None:
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
def test_errors_on_opening_name_the_remedy(number: int, code: int, words: str) -> None:
    text = refusal(FakeCamera("usb-1", fails={number: code}))
    assert words in text and "usb-1" in text and "/dev/video0" in text


def test_a_busy_camera_error_names_the_processes() -> None:
    held_by = ["cheese (process 4711)", "obs (process 12)"]
    text = refusal(FakeCamera("usb-1", fails={S_FMT: errno.EBUSY}, held_by=held_by))
    assert text.endswith("in use by cheese (process 4711), obs (process 12); close it")


def test_permission_denied_on_opening_names_the_group() -> None:
    assert "group video" in refusal(FakeCamera("usb-1", open_errno=errno.EACCES))


def test_every_buffer_is_requeued() -> None:
    camera = FakeCamera("usb-1")
    _, device = opened(camera)
    camera.film(0, 12, 1)
    filled = [device.dequeue(1.0) for _ in range(12)]
    assert [f and f[1] for f in filled] == [JPEG % k for k in range(12)]
    assert len(camera.queued) == 4


def test_close_stops_streaming_frees_buffers_and_is_idempotent() -> None:
    camera = FakeCamera("usb-1")
    io, device = opened(camera)
    device.close()
    device.close()
    assert not camera.streaming and not camera.memory and not io.open_fds


def test_close_of_a_lost_camera_does_not_raise() -> None:
    camera = FakeCamera("usb-1")
    io, device = opened(camera)
    camera.gone = True
    device.close()
    assert not io.open_fds
