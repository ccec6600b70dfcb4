"""`calm-edge setup` on two cameras that are replayed: by options, by answers, and when it fails."""

from __future__ import annotations

import io
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.commands import doctor, setup, setup_views, speed, surroundings, wizard
from calm_edge.commands.speed import Speed
from calm_edge.commands.surroundings import Service
from calm_edge.config import Config, load
from calm_edge.daemon.source import Source
from calm_edge.types import Bytes
from device.camera import FoundCamera
from device.errors import CameraError
from device.frame import jpeg
from tests.commands.camera_bench import LEFT, RIGHT, Bench, sharp_world


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    made = Bench()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(wizard, "discover", made.discover)
    monkeypatch.setattr(wizard, "live", made.live)
    monkeypatch.setattr(setup_views, "SETTLE_S", 0.1)
    monkeypatch.setattr(wizard, "WATCH_S", 0.5)
    monkeypatch.setattr(setup_views, "COVER_POLL_S", 0.1)
    monkeypatch.setattr(wizard, "COVER_POLLS", 25)
    monkeypatch.setattr(speed, "measure", lambda config: Speed(1.0, 3.6, 0.0))
    return made


def answered(monkeypatch: pytest.MonkeyPatch, *answers: str) -> Terminal:
    """Type answers; returns what is shown."""
    shown = Terminal()
    monkeypatch.setattr("sys.stdin", Terminal("\n".join([*answers, ""])))
    monkeypatch.setattr("sys.stderr", shown)
    return shown


def test_two_cameras_are_written_by_port(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["setup", "--yes", "--spacing-m", "0.52", "--port", "udp:localhost:14550"]) == 0
    config = load(Path("kit.toml"))
    assert (config.capture.primary, config.capture.assistant) == (LEFT.address, RIGHT.address)
    assert config.scale.spacing_m == 0.52 and config.pose_output.port == "udp:localhost:14550"
    assert config.backbone.kit_file == str(Path("kit.json").absolute())
    lines = capsys.readouterr().err.splitlines()
    lights = [line for line in lines if line.startswith(("ok ", "note", "fail"))]
    assert all(line.startswith("ok ") for line in lights)
    named = " ".join(line.split(":")[0] for line in lights)
    for eye in ("primary", "assistant"):
        assert all(f"{eye} {what}" in named for what in ("exposure", "focus", "rate"))
    assert "overlap" in named and "speed" in named
    assert lines[-1] == "to record: calm-edge record --config kit.toml --out drives/1"


def test_a_file_keeps_its_comments_and_gives_the_proposals(bench: Bench) -> None:
    Path("kit.toml").write_text(
        "# mine\n[scale]\nspacing_m = 0.4 # tape\n[capture]\n"
        f'primary = "{RIGHT.address}"\nassistant = "{LEFT.address}"\n'
    )
    before = Path("kit.toml").read_text()
    assert main(["setup", "--yes", "--no-speed"]) == 0
    assert bench.opened == [(RIGHT.address, LEFT.address)]
    after = Path("kit.toml").read_text()
    assert after.startswith(before)
    assert set(tomllib.loads(after)) - set(tomllib.loads(before)) == {"backbone"}


@pytest.mark.parametrize(
    ("options", "primary"),
    [
        (["--primary", RIGHT.address], RIGHT.address),
        (["--assistant", RIGHT.address], LEFT.address),
        (["--primary", RIGHT.address, "--assistant", LEFT.address], RIGHT.address),
    ],
)
def test_options_name_the_cameras(bench: Bench, options: list[str], primary: str) -> None:
    assert main(["setup", "--yes", "--no-speed", *options]) == 0
    assert load(Path("kit.toml")).capture.primary == primary


def test_an_address_that_is_not_plugged_in_is_refused(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["setup", "--yes", "--primary", "v4l2:usb-9"]) == 1
    assert "v4l2:usb-9" in capsys.readouterr().err and not Path("kit.toml").exists()


def test_without_two_cameras_it_is_said_what_to_plug_in(
    bench: Bench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.found.remove(RIGHT)
    assert main(["setup", "--yes"]) == 1
    assert "1 of 2 cameras found. Plug in two USB cameras" in capsys.readouterr().err
    shown = answered(monkeypatch, "y", "no")
    assert main(["setup"]) == 1
    assert shown.getvalue().count("1 of 2 cameras found") == 2
    assert not Path("kit.toml").exists()


def test_answers_choose_two_of_three_and_the_primary(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    third = FoundCamera("v4l2:usb-0", "Webcam", "/dev/video4")
    bench.found.append(third)
    answers = ("1 1", "2 3", "4", "2", "52 km", "52 cm", "", "gpsd", "no")
    shown = answered(monkeypatch, *answers)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert main(["setup"]) == 0
    text = shown.getvalue()
    assert "give two of the numbers" in text and "\u2580" in text
    assert "one of 1, 2, c" in text and "'52 km' is no length" in text
    config = load(Path("kit.toml"))
    assert (config.capture.primary, config.capture.assistant) == (RIGHT.address, LEFT.address)
    assert config.gps.source == "gpsd" and config.scale.spacing_m == 0.52


def test_the_covered_camera_becomes_the_primary(bench: Bench) -> None:
    # the replay begins anew when the cameras are opened again to be checked
    bench.dark_from[RIGHT.address] = 20
    assert main(["setup", "--yes", "--cover", "--no-speed"]) == 0
    assert bench.opened == [(LEFT.address, RIGHT.address), (RIGHT.address, LEFT.address)]
    assert load(Path("kit.toml")).capture.primary == RIGHT.address


def test_no_covered_lens_is_one_line(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["setup", "--yes", "--cover", "--no-speed"]) == 1
    assert "no lens became dark" in capsys.readouterr().err.splitlines()[-1]
    assert not Path("kit.toml").exists()


def _dark(picture: Bytes) -> Bytes:
    return picture // 30


def _blurred(picture: Bytes) -> Bytes:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 8), np.uint8)


def _elsewhere(picture: Bytes) -> Bytes:
    gray = sharp_world(7).render(np.eye(4))
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)


@pytest.mark.parametrize(
    ("alter", "words"),
    [
        (_dark, "fail  assistant exposure: too dark"),
        (_blurred, "fail  assistant focus: sharpness 0.0"),
        (_elsewhere, "fail  overlap: "),
    ],
)
def test_a_failed_check_is_red_and_the_file_is_written(
    bench: Bench,
    alter: Callable[[Bytes], Bytes],
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    bench.alter[RIGHT.address] = alter
    assert main(["setup", "--yes", "--no-speed"]) == 3
    assert words in capsys.readouterr().err and Path("kit.toml").exists()


def test_a_slow_camera_is_yellow_or_red(bench: Bench, capsys: pytest.CaptureFixture[str]) -> None:
    for wanted_hz, light, code in ((30, "note", 0), (50, "fail", 3)):
        Path("kit.toml").write_text(f"[capture]\nrate_hz = {wanted_hz}.0\n")
        assert main(["setup", "--yes", "--no-speed"]) == code
        text = capsys.readouterr().err
        assert f"{light}  primary rate: 20.0 Hz of {wanted_hz}, 0 of" in text


def test_it_asks_nobody_without_a_terminal(
    bench: Bench, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    assert main(["setup"]) == 1
    assert "run it in a terminal (ssh -t), or add --yes" in capsys.readouterr().err


def test_an_end_of_input_and_a_refusal_write_nothing(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = answered(monkeypatch, "1")
    assert main(["setup", "--no-speed", "--spacing-m", "0.5"]) == 1
    assert "nothing was written" in shown.getvalue() and not Path("kit.toml").exists()
    Path("kit.toml").write_text("")
    answered(monkeypatch, "1", "", "", "no")
    assert main(["setup", "--no-speed", "--spacing-m", "0.5"]) == 1
    assert Path("kit.toml").read_text() == ""


def test_one_port_for_two_purposes_is_refused(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--port", "/dev/ttyUSB0", "--gps", "/dev/ttyUSB0"]
    assert main(["setup", "--yes", "--no-speed", *options]) == 1
    assert "is pose_output.port as well" in capsys.readouterr().err
    assert not Path("kit.toml").exists()


def test_a_camera_in_use_is_one_line(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def busy(config: Config) -> Source:
        raise CameraError("primary camera v4l2:usb-1: in use by calm-edge (process 7); close it")

    monkeypatch.setattr(wizard, "live", busy)
    assert main(["setup", "--yes"]) == 1
    assert capsys.readouterr().err.splitlines()[-1].endswith("(process 7); close it")


def test_a_folder_stands_in_for_cameras(
    bench: Bench, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for eye, address in enumerate((LEFT.address, RIGHT.address)):
        folder = tmp_path / "drive" / f"cam{eye}"
        folder.mkdir(parents=True)
        for k in range(40):
            (folder / f"{k:06d}.jpg").write_bytes(jpeg(bench.views[address]))
        (folder.parent / f"times{eye}.txt").write_text("".join(f"{k / 20}\n" for k in range(40)))
    options = ["--sequence", str(tmp_path / "drive"), "--picture", "both.jpg", "--no-speed"]
    assert main(["setup", "--yes", "--spacing-m", "0.5", *options]) == 0
    assert tomllib.loads(Path("kit.toml").read_text()) == {"scale": {"spacing_m": 0.5}}
    height, width = cv2.imread("both.jpg").shape[:2]
    assert width == 2 * wizard.PICTURE_PX + 2 and height == wizard.PICTURE_PX // 2
    assert "overlap" in capsys.readouterr().err


def test_the_service_is_started_if_wanted(
    bench: Bench,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    config = tmp_path / "calm-edge.toml"
    config.write_text("")
    for module in (doctor, setup):
        monkeypatch.setattr(module, "SERVICE_CONFIG", config)
    state = Service("inactive", "disabled")
    monkeypatch.setattr(surroundings, "service_state", lambda: state)
    commands: list[str] = []
    monkeypatch.setattr(
        setup, "run_as_root", lambda command, ask: (commands.append(command), True)[1]
    )
    run = partial(main, ["setup", "--yes", "--no-speed"])
    assert run() == 0 and not commands
    assert "to start it: " in capsys.readouterr().err
    assert main(["setup", "--yes", "--no-speed", "--start"]) == 0
    (command,) = commands
    assert "systemctl enable calm-edge" in command and "restart" in command
    answered(monkeypatch, "1", "", "", "y", "y")
    assert main(["setup", "--no-speed", "--spacing-m", "0.5"]) == 0
    assert len(commands) == 2 and load(config).scale.spacing_m == 0.5
