from __future__ import annotations

import errno
from collections.abc import Callable

import numpy as np
import pytest

from device.camera import CameraControls, CameraSpec
from device.drivers.v4l2 import V4l2Camera
from device.errors import CameraError
from device.frame import Eye, Frame
from tests.device.fake_video import ERROR, JPEG, MONOTONIC, FakeCamera, FakeVideoIO, Shot, yuyv
from tests.device.test_v4l2_controls import EXPOSURE, EXPOSURE_AUTO, webcam
from tests.manual_clock import ManualClock

S = 1_000_000_000
MS = 1_000_000
COPY = 0x4000


class Bench:
    """One fake camera on usb-1, opened and running at 10 s."""

    def __init__(
        self,
        address: str = "usb-1",
        wanted: CameraControls = CameraControls(),  # noqa: B008
        rate_hz: float = 10.0,
        **camera: object,
    ) -> None:
        self.clock = ManualClock(10 * S)
        self.device = FakeCamera("usb-1", **camera)  # type: ignore[arg-type]
        self.io = FakeVideoIO(self.clock, {"/dev/video0": self.device})
        spec = CameraSpec(Eye.PRIMARY, "v4l2", address, 8, 4, rate_hz, controls=wanted)
        self.camera = V4l2Camera(spec, self.clock, io=self.io)
        self.camera.start()

    def shoot(self, sequence: int, **changes: object) -> None:
        """Add a JPEG buffer due now, with the fields in `changes` replaced."""
        now_ns = self.clock.now_ns()
        shot = Shot(now_ns, sequence, JPEG % sequence, now_ns, MONOTONIC)
        for name, value in changes.items():
            setattr(shot, name, value)
        self.device.shots.append(shot)

    def read(self) -> Frame:
        frame = self.camera.read(0.0)
        assert frame is not None
        return frame

    def replug(self, path: str) -> FakeCamera:
        """Reconnect the camera at another node; its driver counts from 0 again."""
        self.device = FakeCamera("usb-1", controls=webcam())
        self.io.cameras = {"/dev/video0": FakeCamera("usb-7"), path: self.device}
        return self.device


def test_jpeg_bytes_are_untouched() -> None:
    bench = Bench()
    bench.shoot(0)
    assert bench.read().image == JPEG % 0


def test_yuyv_becomes_bgr_without_row_padding() -> None:
    bench = Bench(fourccs=("YUYV",), stride=20)
    bench.shoot(0, data=yuyv(200, 8, 4, 20))
    image = bench.read().image
    assert isinstance(image, np.ndarray)
    assert image.shape == (4, 8, 3) and image.dtype == np.uint8
    assert np.abs(image.astype(int) - 200).max() <= 1


def test_yuyv_columns_and_colours_keep_their_places() -> None:
    bench = Bench(fourccs=("YUYV",))
    rows = np.full((4, 16), 128, np.uint8)
    rows[:, 0::2] = 16
    rows[:, 8::2] = 81
    rows[:, 9::4], rows[:, 11::4] = 90, 240
    bench.shoot(0, data=rows.tobytes())
    image = bench.read().image
    assert isinstance(image, np.ndarray)
    # the left half is black, the right half is red, in BGR
    assert image[:, :4].max() < 8
    assert image[:, 4:, 2].min() > 240 and image[:, 4:, :2].max() < 16


def test_the_stamp_is_that_of_the_buffer() -> None:
    bench = Bench()
    bench.shoot(0, stamp_ns=10 * S - 30 * MS)
    assert bench.read().t_ns == 10 * S - 30 * MS
    assert bench.camera.stats().host_stamped == 0


@pytest.mark.parametrize("changes", [{"flags": 0}, {"flags": COPY}, {"stamp_ns": 0}])
def test_without_a_monotonic_stamp_the_host_stamps_the_frame(changes: dict[str, int]) -> None:
    bench = Bench()
    bench.shoot(0, **{"stamp_ns": 123 * MS} | changes)
    assert bench.read().t_ns == 10 * S
    assert bench.camera.stats().host_stamped == 1


def test_a_stamp_in_the_future_is_clamped() -> None:
    bench = Bench()
    bench.shoot(0, stamp_ns=10 * S + 178 * MS)
    assert bench.read().t_ns == 10 * S
    assert bench.camera.stats().clamped == 1


@pytest.mark.parametrize("off_s", [-1.5, 0.7, 3600.0])
def test_stamps_of_another_clock_are_replaced_and_said_once(off_s: float) -> None:
    bench = Bench()
    for k in range(3):
        bench.shoot(k, stamp_ns=10 * S + round(off_s * S), due_ns=10 * S + 33 * k * MS)
        frame = bench.camera.read(0.1)
        assert frame is not None and frame.own_stamp
        assert frame.t_ns == 10 * S + 33 * k * MS
    assert bench.camera.stats().host_stamped == 3
    (remark,) = bench.camera.remarks
    assert "another clock" in remark and "primary camera" in remark


@pytest.mark.parametrize("changes", [{"flags": MONOTONIC | ERROR}, {"data": b""}, {"data": b"no"}])
def test_unusable_buffers_are_counted_not_delivered(changes: dict[str, object]) -> None:
    bench = Bench()
    bench.shoot(0, **changes)
    bench.shoot(1, due_ns=10 * S + MS)
    frame = bench.camera.read(0.1)
    assert frame is not None and frame.sequence == 1
    assert bench.camera.stats().corrupt == 1


def test_an_unusable_buffer_is_not_a_drop_too() -> None:
    bench = Bench()
    for sequence in range(6):
        bench.shoot(sequence, flags=MONOTONIC | (ERROR if sequence in (2, 3) else 0))
    # number 6 is missing as well
    bench.shoot(7)
    frames = [bench.camera.read(0.0) for _ in range(7)]
    assert [f.sequence for f in frames if f] == [0, 1, 4, 5, 7]
    stats = bench.camera.stats()
    assert (stats.frames, stats.corrupt, stats.drops) == (5, 2, 1)


def test_short_yuyv_is_corrupt() -> None:
    bench = Bench(fourccs=("YUYV",))
    bench.shoot(0, data=yuyv(9, 8, 3, 16))
    assert bench.camera.read(0.0) is None
    assert bench.camera.stats().corrupt == 1


def unplug(bench: Bench) -> None:
    bench.device.gone = True


def input_output_error(bench: Bench) -> None:
    bench.device.fails[0x11] = errno.EIO
    bench.shoot(9)


@pytest.mark.parametrize("lose", [unplug, input_output_error])
def test_a_lost_camera_is_found_again_by_its_bus(lose: Callable[[Bench], None]) -> None:
    bench = Bench("/dev/video0")
    bench.shoot(5)
    assert bench.read().sequence == 5
    lose(bench)
    assert bench.camera.read(0.5) is None
    assert bench.clock.now_ns() == 10 * S + 500 * MS
    assert not bench.camera.connected and not bench.io.open_fds

    # meanwhile another camera has taken the old node number
    bench.replug("/dev/video4").film(12 * S, 3, 100 * MS)
    frames = [bench.camera.read(3.0) for _ in range(3)]
    assert [f and f.sequence for f in frames] == [6, 7, 8]
    assert [f and f.t_ns for f in frames] == [12 * S, 12 * S + 100 * MS, 12 * S + 200 * MS]
    stats = bench.camera.stats()
    assert (stats.reconnects, stats.drops) == (1, 0)
    assert bench.camera.connected


def test_a_missing_camera_is_searched_every_second_without_raising() -> None:
    bench = Bench()
    attempts: list[int] = []
    bench.device.gone = True

    def nodes() -> list[str]:
        attempts.append(bench.clock.now_ns())
        return []

    bench.io.nodes = nodes  # type: ignore[method-assign]
    for _ in range(50):
        assert bench.camera.read(0.1) is None
    assert attempts == [11 * S, 12 * S, 13 * S, 14 * S, 15 * S]
    assert bench.camera.stats().reconnects == 0


def test_a_camera_without_permission_is_retried() -> None:
    bench = Bench()
    bench.device.gone = True
    bench.camera.read(0.1)
    bench.replug("/dev/video1").open_errno = errno.EACCES
    assert bench.camera.read(2.0) is None
    bench.device.open_errno = 0
    bench.device.film(13 * S, 1, MS)
    assert bench.camera.read(2.0) is not None


def test_start_without_the_camera_raises() -> None:
    clock = ManualClock()
    io = FakeVideoIO(clock, {})
    with pytest.raises(CameraError, match="primary camera v4l2:usb-3: not found"):
        V4l2Camera(CameraSpec(Eye.PRIMARY, "v4l2", "usb-3"), clock, io=io).start()


def test_a_streaming_camera_without_frames_is_reopened() -> None:
    bench = Bench()
    bench.shoot(0)
    bench.read()
    assert bench.camera.read(2.9) is None and bench.camera.connected
    bench.device.film(14 * S + 500 * MS, 1, MS, sequence=40)
    frame = bench.camera.read(3.0)
    assert frame is not None and frame.t_ns == 14 * S + 500 * MS
    assert bench.camera.stats().reconnects == 1
    assert len(bench.io.open_fds) == 1


def test_a_camera_that_only_reports_errors_is_reopened_and_warned_of_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bench = Bench()
    for k in range(200):
        t_ns = 10 * S + k * 100 * MS
        bench.device.shots.append(Shot(t_ns, k, JPEG % k, t_ns, MONOTONIC | ERROR))
    while bench.clock.now_ns() < 25 * S:
        assert bench.camera.read(0.5) is None
    assert bench.camera.stats().reconnects >= 3
    warnings = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
    assert len(warnings) == 1 and "no usable image for 3 s (31 corrupt)" in warnings[0]
    # once it delivers again, the next failure is new
    bench.device.shots.clear()
    bench.device.film(bench.clock.now_ns() + S, 1, MS, sequence=500)
    assert bench.camera.read(3.0) is not None
    while bench.camera.connected:
        bench.camera.read(0.5)
    assert len([r for r in caplog.records if r.levelname == "WARNING"]) == 2


def filmed(period_ms: int, **camera: object) -> Bench:
    """A camera asked for 10 Hz that delivers a JPEG every period_ms, for 8 s."""
    bench = Bench(**camera)  # type: ignore[arg-type]
    bench.device.film(10 * S, 8000 // period_ms, period_ms * MS)
    while bench.camera.read(0.5) is not None:
        pass
    return bench


def test_the_rate_is_measured_not_believed() -> None:
    bench = filmed(200)
    assert bench.camera.settings["rate_hz"] == 10.0
    assert bench.camera.settings["measured_hz"] == 5.0
    (line,) = bench.camera.remarks
    assert "delivers 5.0 Hz, not 10" in line and "capture.exposure_us to less than 100000" in line


def test_a_camera_that_ignores_a_low_rate_is_remarked() -> None:
    (line,) = filmed(33).camera.remarks
    assert "delivers 30.3 Hz, not 10: it ignores capture.rate_hz" in line


def test_a_rate_that_falls_at_dusk_is_remarked_once() -> None:
    bench = filmed(100)
    assert bench.camera.settings["measured_hz"] == 10.0 and not bench.camera.remarks
    for start_s, period_ms in ((18, 200), (30, 100), (42, 150)):
        bench.clock.sleep_until_ns(start_s * S)
        bench.device.film(start_s * S, 10_000 // period_ms, period_ms * MS)
        while bench.camera.read(0.5) is not None:
            pass
    assert len(bench.camera.remarks) == 1


@pytest.mark.parametrize("period_ms", [95, 100, 105])
def test_a_rate_near_the_one_asked_for_gives_no_remark(period_ms: int) -> None:
    assert not filmed(period_ms).camera.remarks


def test_a_slow_rate_that_the_camera_admits_is_remarked_on_opening_only() -> None:
    (line,) = filmed(200, intervals=((1, 5),)).camera.remarks
    assert "gives 5 Hz, not 10" in line


def test_a_slow_camera_is_not_reopened() -> None:
    bench = Bench()
    bench.device.film(12 * S, 3, 2900 * MS)
    for _ in range(3):
        assert bench.camera.read(5.0) is not None
    assert bench.camera.stats().reconnects == 0


def test_a_camera_named_by_its_serial_may_come_back_on_another_port() -> None:
    bench = Bench("serial=A7", serial="A7")
    bench.device.gone = True
    bench.camera.read(0.1)
    other = FakeCamera("usb-3", serial="A7")
    bench.io.cameras = {"/dev/video0": FakeCamera("usb-1", serial="B2"), "/dev/video5": other}
    other.film(12 * S, 1, MS)
    frame = bench.camera.read(3.0)
    assert frame is not None and bench.camera.settings["address"] == "usb-3"


def test_settings_are_read_back() -> None:
    bench = Bench(wanted=CameraControls(exposure_us=8000), controls=webcam(), serial="A7")
    assert bench.camera.settings == {
        "name": "Fake",
        "address": "usb-1",
        "serial": "A7",
        "path": "/dev/video0",
        "format": "MJPG",
        "width_px": 8,
        "height_px": 4,
        "rate_hz": 10.0,
        "exposure_us": 8000,
        "gain": 64,
        "white_balance_k": "auto",
        "focus": 30,
    }


def test_exposure_is_locked_after_two_seconds_and_after_a_reconnect() -> None:
    wanted = CameraControls(exposure_us="auto-then-lock")
    bench = Bench(wanted=wanted, controls=webcam())
    bench.device.film(10 * S, 25, 100 * MS)
    for _ in range(19):
        assert bench.camera.read(1.0) is not None
    bench.device.controls[EXPOSURE].value = 40
    assert bench.device.controls[EXPOSURE_AUTO].value == 3
    for _ in range(3):
        assert bench.camera.read(1.0) is not None
    assert bench.device.controls[EXPOSURE_AUTO].value == 1
    assert bench.camera.settings["exposure_us"] == 4000

    bench.device.gone = True
    bench.camera.read(0.1)
    bench.replug("/dev/video4").film(14 * S, 1, MS)
    assert bench.camera.read(3.0) is not None
    controls = bench.device.controls
    assert (controls[EXPOSURE_AUTO].value, controls[EXPOSURE].value) == (1, 40)


def test_unfulfilled_requests_are_remarked_once() -> None:
    slow = {"intervals": ((1, 5),)}
    bench = Bench(wanted=CameraControls(gain=9), **slow)  # type: ignore[arg-type]
    bench.device.gone = True
    bench.camera.read(0.1)
    bench.device.gone = False
    bench.device.film(12 * S, 1, MS)
    assert bench.camera.read(3.0) is not None
    slow_line, gain_line = bench.camera.remarks
    assert "usb-1: gives 5 Hz, not 10, as MJPG at 8x4" in slow_line
    assert "usb-1: has no gain" in gain_line
