from __future__ import annotations

import io
import json
import tomllib
from pathlib import Path

import pytest

from calm_edge.cli import main
from device import camera
from device.camera import FoundCamera

LEFT = FoundCamera(
    "v4l2:usb-1", "Left", "/dev/video0", "A7", {"MJPG": ["1280x720 30 Hz"]}, {"Gain": "7 (0 to 9)"}
)
RIGHT = FoundCamera("v4l2:usb-2", "Right", "/dev/video2", note="/dev/video2: in use; close it")


@pytest.fixture
def there(monkeypatch: pytest.MonkeyPatch) -> list[FoundCamera]:
    """The cameras of this machine."""
    cameras = [RIGHT, LEFT]
    monkeypatch.setattr(camera, "discover", lambda details=True: (list(cameras), []))
    return cameras


@pytest.mark.usefixtures("there")
def test_identity_formats_controls_and_errors_are_listed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["cameras"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "v4l2:usb-2  Right  /dev/video2",
        "    /dev/video2: in use; close it",
        "v4l2:usb-1  Left  /dev/video0  serial A7",
        "    MJPG: 1280x720 30 Hz",
        "    Gain = 7 (0 to 9)",
    ]


@pytest.mark.usefixtures("there")
def test_json_holds_every_field(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["cameras", "--json"]) == 0
    right, left = json.loads(capsys.readouterr().out)["cameras"]
    assert left["address"] == "v4l2:usb-1" and left["serial"] == "A7"
    assert left["formats"] == {"MJPG": ["1280x720 30 Hz"]}
    assert right["note"]


@pytest.mark.usefixtures("there")
def test_write_takes_two_cameras_by_port(tmp_path: Path) -> None:
    path = tmp_path / "kit.toml"
    path.write_text("[scale]\nspacing_m = 0.5 # kept\n")
    assert main(["cameras", "--write", str(path)]) == 0
    assert "spacing_m = 0.5 # kept" in path.read_text()
    written = tomllib.loads(path.read_text())["capture"]
    assert written == {"primary": "v4l2:usb-1", "assistant": "v4l2:usb-2"}


def test_write_does_not_choose_among_three(
    there: list[FoundCamera], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there.append(FoundCamera("v4l2:usb-3", "Third", "/dev/video4"))
    assert main(["cameras", "--write", str(tmp_path / "kit.toml")]) == 1
    assert "3 camera(s) found" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("there")
def test_identify_without_a_terminal_raises_one_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    text = io.StringIO()
    monkeypatch.setattr("sys.stderr", text)
    assert main(["cameras", "--identify"]) == 1
    assert len(text.getvalue().splitlines()) == 1 and "run it in a terminal" in text.getvalue()


def test_identify_writes_the_camera_unplugged_first_as_primary(
    there: list[FoundCamera],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Terminal(io.StringIO):
        """Text stream whose prompts trigger the unplugging."""

        def isatty(self) -> bool:
            return True

        def write(self, text: str) -> int:
            if "unplug" in text:
                there.remove(RIGHT)
            elif "plug it in" in text:
                there.append(RIGHT)
            return super().write(text)

    monkeypatch.setattr("sys.stderr", Terminal())
    path = tmp_path / "kit.toml"
    assert main(["cameras", "--identify", "--write", str(path)]) == 0
    assert tomllib.loads(path.read_text())["capture"]["primary"] == "v4l2:usb-2"
    assert capsys.readouterr().out.splitlines() == [
        'primary = "v4l2:usb-2"',
        'assistant = "v4l2:usb-1"',
    ]


def test_no_camera_is_an_error(
    there: list[FoundCamera], capsys: pytest.CaptureFixture[str]
) -> None:
    there.clear()
    assert main(["cameras"]) == 1
    assert "no camera found" in capsys.readouterr().err
    assert main(["cameras", "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == {"cameras": []}
