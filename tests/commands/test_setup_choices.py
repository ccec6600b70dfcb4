"""Choices of a set-up: which cameras, which keys change, and what is refused."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from calm_edge.commands import setup_choices
from calm_edge.commands.setup_choices import Choices
from calm_edge.config import Config, ConfigError, merge
from device.camera import FoundCamera
from device.errors import CameraError

A, B, C = (FoundCamera(f"v4l2:usb-{k}", f"Camera {k}", f"/dev/video{k}") for k in range(3))


def test_cameras_chosen_before_are_proposed_again() -> None:
    by_name = FoundCamera("v4l2:usb-0.infrared", "IR", "/dev/video9", by_name_only=True)
    cameras = setup_choices.usable([C, by_name, A, B])
    assert cameras == [A, B, C]
    capture = Config().capture
    assert setup_choices.proposed(cameras, capture) == [A, B]
    before = merge(Config(), {"capture": {"primary": C.address, "assistant": A.address}}).capture
    assert setup_choices.proposed(cameras, before) == [C, A]
    assert setup_choices.proposed([A, B], before) == [A, B]


@pytest.mark.parametrize(
    ("primary", "assistant", "pair"),
    [
        (None, None, [A, B]),
        (B.address, None, [B, A]),
        (C.address, None, [C, A]),
        (None, A.address, [B, A]),
        (C.address, B.address, [C, B]),
        (B.address, C.address, [B, C]),
    ],
)
def test_a_given_camera_takes_its_place(
    primary: str | None, assistant: str | None, pair: list[FoundCamera]
) -> None:
    assert setup_choices.arranged([A, B], [A, B, C], primary, assistant) == pair


def test_a_camera_that_is_not_there_is_refused() -> None:
    for given in (("v4l2:usb-9", None), ("v4l2:usb-9", A.address)):
        with pytest.raises(CameraError, match="v4l2:usb-9: not plugged in"):
            setup_choices.arranged([A, B], [A, B], *given)


def test_only_what_differs_is_written_and_then_nothing_is_left(tmp_path: Path) -> None:
    path = tmp_path / "kit.toml"
    choices = Choices(merge(Config(), {"scale": {"spacing_m": 0.5}}))
    choices.take([A, B])
    choices.swap()
    choices.set_spacing(0.5)
    choices.set_ports("none", "gpsd")
    kit = str(path.with_suffix(".json"))
    wanted = {
        "capture": {"primary": B.address, "assistant": A.address},
        "gps": {"source": "gpsd"},
        "backbone": {"kit_file": kit},
    }
    assert choices.new_keys(path) == wanted and choices.pair == [B, A]
    choices.write(path)
    assert tomllib.loads(path.read_text()) == wanted
    assert choices.new_keys(path) == {}


def test_addresses_can_be_swapped_as_well() -> None:
    choices = Choices(Config())
    assert not choices.has_cameras
    choices.take_addresses("oak:1/CAM_B", "oak:1/CAM_C")
    choices.swap()
    assert choices.has_cameras and choices.config.capture.primary == "oak:1/CAM_C"


def test_one_port_for_two_purposes_cannot_be_written(tmp_path: Path) -> None:
    choices = Choices(Config())
    choices.set_ports("/dev/ttyUSB0", "/dev/ttyUSB0")
    with pytest.raises(ConfigError, match=r"is pose_output\.port as well"):
        choices.write(tmp_path / "kit.toml")
    assert not list(tmp_path.iterdir())


def test_a_spacing_is_a_length_that_can_be_meant() -> None:
    assert setup_choices.spacing_of("52 cm") == 0.52 and setup_choices.spacing_of("none") == 0
    for text, why in (("52", "0.01 to 10 m can be meant"), ("wide", "is no length")):
        with pytest.raises(ValueError, match=why):
            setup_choices.spacing_of(text)


def test_serial_devices_are_listed(tmp_path: Path) -> None:
    for name in ("ttyUSB1", "ttyACM0", "tty3", "video0"):
        (tmp_path / name).touch()
    found = setup_choices.serial_devices(tmp_path)
    assert found == [str(tmp_path / "ttyACM0"), str(tmp_path / "ttyUSB1")]
