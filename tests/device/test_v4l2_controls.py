from __future__ import annotations

import pytest

from device.camera import CameraControls
from device.drivers.v4l2_controls import ControlKeeper, list_controls
from device.errors import CameraError
from tests.device.fake_video import FakeCamera, FakeVideoIO, Knob, system

WHITE_AUTO, AUTOGAIN, GAIN, WHITE = 0x0098090C, 0x00980912, 0x00980913, 0x0098091A
EXPOSURE_AUTO, EXPOSURE, PRIORITY = 0x009A0901, 0x009A0902, 0x009A0903
FOCUS, FOCUS_AUTO = 0x009A090A, 0x009A090C


def webcam(**changes: Knob) -> dict[int, Knob]:
    """The controls of a typical USB camera, all automatic."""
    knobs = {
        WHITE_AUTO: Knob("White Balance, Automatic", 1, 0, 1),
        GAIN: Knob("Gain", 64, 0, 255),
        WHITE: Knob("White Balance Temperature", 4600, 2800, 6500, 10),
        EXPOSURE_AUTO: Knob("Auto Exposure", 3, 0, 3),
        EXPOSURE: Knob("Exposure Time, Absolute", 156, 3, 2047),
        PRIORITY: Knob("Exposure, Dynamic Framerate", 1, 0, 1),
        FOCUS: Knob("Focus, Absolute", 30, 0, 250, 5),
        FOCUS_AUTO: Knob("Focus, Automatic Continuous", 1, 0, 1),
    }
    return knobs | {globals()[name]: knob for name, knob in changes.items()}


def applied(
    knobs: dict[int, Knob], **wanted: int | str
) -> tuple[ControlKeeper, FakeVideoIO, int, dict[int, Knob]]:
    io = system(video0=FakeCamera("usb-1", controls=knobs))
    fd = io.open("/dev/video0")
    keeper = ControlKeeper("primary camera", CameraControls(**wanted))  # type: ignore[arg-type]
    keeper.apply(io, fd)
    return keeper, io, fd, knobs


def test_by_default_only_focus_is_locked() -> None:
    keeper, _, _, knobs = applied(webcam())
    assert knobs[FOCUS_AUTO].value == 0 and knobs[FOCUS].value == 30
    assert knobs[EXPOSURE_AUTO].value == 3 and knobs[WHITE_AUTO].value == 1
    assert keeper.settings == {
        "exposure_us": "auto",
        "gain": 64,
        "white_balance_k": "auto",
        "focus": 30,
    }
    assert not keeper.remarks and not keeper.pending


def test_exposure_may_not_lower_the_frame_rate() -> None:
    assert applied(webcam())[3][PRIORITY].value == 0


def test_numbers_are_set_locked_and_read_back_in_their_units() -> None:
    wanted = {"exposure_us": 8000, "gain": 20, "white_balance_k": 5000, "focus": 0}
    keeper, _, _, knobs = applied(webcam(), **wanted)
    assert knobs[EXPOSURE_AUTO].value == 1 and knobs[EXPOSURE].value == 80
    assert knobs[WHITE_AUTO].value == 0 and knobs[WHITE].value == 5000
    assert knobs[GAIN].value == 20 and (knobs[FOCUS_AUTO].value, knobs[FOCUS].value) == (0, 0)
    assert keeper.settings == wanted
    assert not keeper.remarks


def test_a_number_out_of_range_is_clipped_and_remarked() -> None:
    keeper, _, _, knobs = applied(webcam(), exposure_us=10_000_000, white_balance_k=2804)
    assert knobs[EXPOSURE].value == 2047 and knobs[WHITE].value == 2800
    assert keeper.settings["exposure_us"] == 204_700
    assert "exposure_us = 10000000" in keeper.remarks[0] and "300 to 204700" in keeper.remarks[0]


def test_auto_then_lock_locks_the_converged_value() -> None:
    keeper, io, fd, knobs = applied(webcam(), exposure_us="auto-then-lock", focus="auto-then-lock")
    assert knobs[EXPOSURE_AUTO].value == 3 and knobs[FOCUS_AUTO].value == 1
    assert keeper.pending
    # meanwhile the camera's exposure converges
    knobs[EXPOSURE].value, knobs[FOCUS].value = 40, 15
    keeper.lock_settled(io, fd)
    assert not keeper.pending
    assert knobs[EXPOSURE_AUTO].value == 1 and knobs[FOCUS_AUTO].value == 0
    assert keeper.settings["exposure_us"] == 4000 and keeper.settings["focus"] == 15


def test_locked_values_are_restored_after_a_reconnect() -> None:
    keeper, io, fd, knobs = applied(webcam(), exposure_us="auto-then-lock")
    knobs[EXPOSURE].value = 40
    keeper.lock_settled(io, fd)
    io.cameras["/dev/video0"].controls = fresh = webcam(FOCUS=Knob("Focus", 200, 0, 250, 5))
    keeper.apply(io, fd)
    assert not keeper.pending
    assert fresh[EXPOSURE_AUTO].value == 1 and fresh[EXPOSURE].value == 40
    assert fresh[FOCUS_AUTO].value == 0 and fresh[FOCUS].value == 30


def test_an_autofocus_that_cannot_be_switched_off_raises_unless_requested() -> None:
    stuck = {"FOCUS_AUTO": Knob("Focus, Automatic Continuous", 1, 0, 1, stuck=True)}
    with pytest.raises(CameraError, match=r'autofocus cannot .* capture.focus = "auto"'):
        applied(webcam(**stuck))
    with pytest.raises(CameraError, match="autofocus"):
        applied(webcam(**stuck), focus=30)
    assert applied(webcam(**stuck), focus="auto")[0].settings["focus"] == "auto"


def test_an_exposure_that_cannot_be_locked_is_remarked() -> None:
    stuck = Knob("Auto Exposure", 3, 0, 3, stuck=True)
    keeper, _, _, _ = applied(webcam(EXPOSURE_AUTO=stuck), exposure_us=8000)
    assert keeper.settings["exposure_us"] == "auto"
    assert keeper.remarks == ["primary camera: exposure_us cannot be locked, it stays automatic"]


def test_a_missing_control_is_remarked_only_if_a_value_was_requested() -> None:
    keeper, _, _, _ = applied({}, exposure_us=8000)
    assert set(keeper.settings.values()) == {"absent"}
    assert keeper.remarks == ["primary camera: has no exposure_us control; not set"]


def test_automatic_exposure_without_aperture_priority() -> None:
    # aperture priority (3) is out of the control's range
    knob = Knob("Auto Exposure", 1, 0, 1)
    assert applied(webcam(EXPOSURE_AUTO=knob), exposure_us="auto")[3][EXPOSURE_AUTO].value == 0


@pytest.mark.parametrize("changes", [{"refused": True}, {"stuck": True}])
def test_a_frame_rate_that_cannot_be_held_is_remarked(changes: dict[str, bool]) -> None:
    knob = Knob("Exposure, Dynamic Framerate", 1, 0, 1, **changes)  # type: ignore[arg-type]
    (line,) = applied(webcam(PRIORITY=knob))[0].remarks
    assert "may lower its frame rate in the dark" in line and "capture.exposure_us" in line
    # a fixed exposure cannot grow in the dark
    assert not applied(webcam(PRIORITY=knob), exposure_us=8000)[0].remarks


def test_a_camera_without_that_control_gives_no_remark() -> None:
    knobs = webcam()
    del knobs[PRIORITY]
    assert not applied(knobs)[0].remarks


def test_a_value_that_is_accepted_but_not_applied_is_remarked() -> None:
    knob = Knob("Gain", 64, 0, 255, stuck=True)
    keeper, _, _, _ = applied(webcam(GAIN=knob), gain=20)
    assert keeper.remarks == ["primary camera: gain = 20 not applied, it is 64"]
    assert keeper.settings["gain"] == 64


def test_a_refused_value_is_remarked() -> None:
    knob = Knob("Gain", 64, 0, 255, refused=True)
    keeper, _, _, _ = applied(webcam(GAIN=knob), gain=20)
    assert keeper.remarks == ["primary camera: gain was not accepted"]


def test_an_automatic_mode_that_is_ignored_is_remarked() -> None:
    knob = Knob("Auto Exposure", 1, 0, 3, stuck=True)
    keeper, _, _, _ = applied(webcam(EXPOSURE_AUTO=knob), exposure_us="auto-then-lock")
    assert keeper.remarks == ["primary camera: exposure_us cannot be automatic"]
    assert keeper.settings["exposure_us"] == 15_600 and not keeper.pending


def test_a_read_only_value_is_not_written() -> None:
    knob = Knob("Focus, Absolute", 30, 0, 250, 5, flags=4)
    keeper, _, _, _ = applied(webcam(FOCUS=knob), focus=100)
    assert knob.value == 30 and keeper.settings["focus"] == 30
    assert keeper.remarks == ["primary camera: focus = 100 not applied, it is 30"]


def test_an_endless_control_list_is_cut_off() -> None:
    io = system(video0=FakeCamera("usb-1", controls={7: Knob("Odd", 1)}))
    fd = io.open("/dev/video0")
    real = io.ioctl

    def always_seven(fd: int, request: int, argument: bytearray) -> None:
        argument[0:4] = (0x80000000).to_bytes(4, "little")
        real(fd, request, argument)

    io.ioctl = always_seven  # type: ignore[method-assign]
    assert [c.id for c in list_controls(io, fd)] == [7]


@pytest.mark.parametrize("word", ["manual", "AUTO", ""])
def test_an_unknown_mode_raises_with_the_valid_ones(word: str) -> None:
    with pytest.raises(CameraError, match=r"capture.gain = .*auto, auto-then-lock, lock"):
        CameraControls(gain=word)
