"""`calm-edge setup --page` on two cameras that are replayed, without a browser."""

from __future__ import annotations

import io
import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calm_edge.cli import main
from calm_edge.commands import service_start, setup, setup_page, setup_views, speed
from calm_edge.commands.setup_choices import Choices
from calm_edge.commands.setup_page import SetupError, SetupPage
from calm_edge.commands.speed import Speed, SpeedError
from calm_edge.config import Config, load
from calm_edge.daemon.source import Source
from calm_edge.live.board import Board
from calm_edge.live.wire import Message
from calm_edge.types import Bytes, CalmEdgeError
from device.camera import FoundCamera
from device.errors import CameraError
from tests.commands.camera_bench import LEFT, RIGHT, Bench


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    made = Bench()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(setup_page, "discover", made.discover)
    monkeypatch.setattr(setup_page, "live", made.live)
    for module, name, value in (
        (setup_views, "SETTLE_S", 0.05),
        (setup_views, "COVER_POLL_S", 0.06),
        (setup_page, "COVER_POLLS", 15),
        (setup_page, "LOOK_S", 0.1),
        (setup_page, "PICTURE_S", 0.1),
        (setup_page, "CHECK_S", 0.3),
    ):
        monkeypatch.setattr(module, name, value)
    return made


class Running:
    """A page that runs, and what it shows."""

    def __init__(self, startable: bool = False) -> None:
        self.board: Board[Message] = Board()
        self.path = Path("kit.toml")
        self.page = SetupPage(Choices(Config()), self.path, self.board, startable=startable)
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self.page.run, args=(self.stopped,))
        self.thread.start()

    def shown(self) -> dict[str, Any]:
        message = self.board.get("setup")
        assert message is not None
        return dict(message.content)

    def until(self, condition: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
        end = time.monotonic() + 20
        while not condition(shown := self.shown()):
            assert time.monotonic() < end, shown
            time.sleep(0.01)
        return shown

    def close(self) -> None:
        self.stopped.set()
        self.thread.join(10)
        assert not self.thread.is_alive()


@pytest.fixture
def run(bench: Bench) -> Iterator[Running]:
    running = Running()
    yield running
    running.close()


def test_pictures_lights_and_choices_are_shown_and_written(run: Running, bench: Bench) -> None:
    shown = run.until(lambda s: s["lights"])
    assert shown["sentence"] == "Both cameras are fine." and shown["level"] == "good"
    names = [light["name"] for light in shown["lights"]]
    assert {"primary exposure", "assistant focus", "overlap", "primary rate"} <= set(names)
    for eye in ("primary", "assistant"):
        message = run.board.get(eye)
        assert message is not None
        picture = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape[1] <= setup_views.WIDTH_PX
    run.page.ask("pair", {"primary": RIGHT.address, "assistant": LEFT.address})
    run.page.ask("spacing", {"text": "52 cm"})
    run.page.ask("ports", {"port": "", "gps": "gpsd"})
    run.until(lambda s: bench.opened[-1] == (RIGHT.address, LEFT.address))
    run.page.ask("write", {})
    shown = run.until(lambda s: s["written"])
    assert shown["keys"] == [] and "--config kit.toml" in shown["record"]
    config = load(run.path)
    assert (config.capture.primary, config.capture.assistant) == (RIGHT.address, LEFT.address)
    assert config.scale.spacing_m == 0.52 and config.gps.source == "gpsd"
    run.page.ask("finish", {})
    run.thread.join(10)
    assert run.page.written and run.shown()["ended"]


def test_too_few_cameras_until_the_second_is_plugged_in(bench: Bench) -> None:
    bench.found.remove(RIGHT)
    run = Running()
    run.until(lambda s: s["sentence"].startswith("1 of 2 cameras found. Plug in"))
    for kind, content in (
        ("write", {}),
        ("cover", {}),
        ("start", {}),
        ("pair", {"primary": LEFT.address, "assistant": RIGHT.address}),
    ):
        with pytest.raises(SetupError):
            run.page.ask(kind, content)
    bench.found.append(RIGHT)
    run.until(lambda s: s["lights"])
    run.close()
    assert not run.path.exists() and not run.page.written
    assert "nothing was written" in run.shown()["sentence"]


def test_what_is_no_answer_is_refused(run: Running) -> None:
    run.until(lambda s: s["chosen"])
    for kind, content, why in (
        ("spacing", {"text": "52"}, "can be meant"),
        ("spacing", {"text": 0.52}, "expected a text"),
        ("ports", {"port": "x" * 300, "gps": ""}, "at most 200"),
        ("pair", {"primary": LEFT.address, "assistant": LEFT.address}, "two different"),
        ("pair", {"primary": LEFT.address, "assistant": "v4l2:usb-9"}, "not plugged in"),
    ):
        with pytest.raises(CalmEdgeError, match=why):
            run.page.ask(kind, content)
    run.page.ask("ports", {"port": "/dev/ttyUSB0", "gps": "/dev/ttyUSB0"})
    assert "pose_output.port as well" in run.shown()["objection"]
    with pytest.raises(CalmEdgeError, match="as well"):
        run.page.ask("write", {})
    assert not run.path.exists()


def test_the_covered_camera_becomes_the_primary(bench: Bench) -> None:
    bench.dark_from[RIGHT.address] = 14
    run = Running()
    run.until(lambda s: s["chosen"])
    run.page.ask("cover", {})
    with pytest.raises(SetupError, match="cover has not ended"):
        run.page.ask("speed", {})
    shown = run.until(lambda s: s["primary"] == RIGHT.address)
    assert shown["sentence"] == f"The primary is {RIGHT.address}. Uncover its lens."
    run.until(lambda s: bench.opened[-1] == (RIGHT.address, LEFT.address))
    run.close()


def test_no_covered_lens_is_said_and_the_checks_go_on(run: Running) -> None:
    run.until(lambda s: s["chosen"])
    run.page.ask("cover", {})
    run.until(lambda s: "no lens became dark" in s["notice"])
    run.until(lambda s: s["lights"])


def test_a_fault_of_a_camera_is_shown_and_tried_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def busy(config: Config) -> Source:
        raise CameraError("v4l2:usb-1: in use by calm-edge (process 7); close it")

    monkeypatch.setattr(setup_page, "live", busy)
    run = Running()
    run.until(lambda s: s["sentence"].endswith("(process 7); close it") and s["level"] == "bad")
    monkeypatch.setattr(setup_page, "live", bench.live)
    run.until(lambda s: s["lights"])
    run.close()


def test_the_speed_is_measured_while_the_cameras_are_off(
    run: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    run.until(lambda s: s["chosen"])
    monkeypatch.setattr(speed, "measure", lambda config: Speed(1.0, 3.6, 0.0))
    run.page.ask("speed", {})
    shown = run.until(lambda s: s["speed"])
    assert "live poses keep up" in shown["speed"]["text"] and shown["speed"]["level"] == "good"

    def fails(config: Config) -> Speed:
        raise SpeedError("three windows take longer than 15 minutes")

    monkeypatch.setattr(speed, "measure", fails)
    run.until(lambda s: not s["busy"])
    run.page.ask("speed", {})
    run.until(lambda s: "not measured: three windows take longer" in s["notice"])


@pytest.mark.parametrize("works", [True, False])
def test_the_service_is_started_once_the_file_is_written(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, works: bool
) -> None:
    commands = []

    def as_root(command: str, *, ask: bool) -> bool:
        # nobody looks at the terminal, in which sudo would ask
        commands.append((command, ask))
        return works

    monkeypatch.setattr(service_start, "run_as_root", as_root)
    run = Running(startable=True)
    run.until(lambda s: s["chosen"])
    with pytest.raises(SetupError, match="write the configuration"):
        run.page.ask("start", {})
    run.page.ask("write", {})
    run.page.ask("start", {})
    if works:
        run.until(lambda s: s["ended"] and s["sentence"].endswith("The service records."))
    else:
        run.until(lambda s: "not started; type: sudo sh -c" in s["notice"])
    assert commands == [(service_start.COMMAND, False)]
    run.close()


def _dark(picture: Bytes) -> Bytes:
    return picture // 30


def test_the_command_serves_the_page_under_a_token(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.alter[RIGHT.address] = _dark
    printed = io.StringIO()
    monkeypatch.setattr("sys.stdout", printed)
    # a signal handler is for the main thread
    stopped = threading.Event()
    monkeypatch.setattr(setup, "serve", lambda server: (_serve(server), stopped)[1])
    codes: list[int] = []
    options = ["setup", "--page", "--address", "127.0.0.1:0", "--spacing-m", "0.5"]
    thread = threading.Thread(target=lambda: codes.append(main(options)))
    thread.start()
    while "\n" not in printed.getvalue():
        time.sleep(0.01)
    found = re.fullmatch(
        r"page        http://127\.0\.0\.1:(\d+)/\?token=([\w-]{16,})\n", printed.getvalue()
    )
    assert found

    def request(method: str, path: str, cookie: str = "") -> tuple[int, bytes]:
        connection = HTTPConnection("127.0.0.1", int(found[1]), timeout=10)
        headers = {"X-Calm-Edge": "page", "Cookie": cookie}
        connection.request(method, path, b"{}" if method == "POST" else None, headers)
        answer = connection.getresponse()
        status, body = answer.status, answer.read() if path != "/stream" else _lights(answer)
        connection.close()
        return status, body

    # other users of this computer reach the loopback address too
    assert request("GET", "/")[0] == 401 and request("POST", "/write")[0] == 401
    cookie = f"calm_edge_token={found[2]}"
    page = request("GET", "/", cookie)
    assert page[0] == 200 and b"calm-edge setup" in page[1]
    assert request("POST", "/event", cookie)[0] == 400
    assert request("GET", "/stream", cookie)[0] == 200
    assert request("POST", "/spacing", cookie) == (
        409,
        b"text: expected a text of at most 200 characters\n",
    )
    assert request("POST", "/write", cookie)[0] == 202
    assert request("POST", "/finish", cookie)[0] == 202
    thread.join(20)
    # a check failed
    assert codes == [3] and load(Path("kit.toml")).scale.spacing_m == 0.5


def _serve(server: Any) -> None:
    threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True).start()


def _lights(stream: Any) -> bytes:
    """Read a stream until it shows traffic lights."""
    while True:
        line = bytes(stream.readline())
        if line.startswith(b"data: ") and json.loads(line[6:]).get("lights"):
            return line


def test_options_of_the_terminal_are_refused(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["setup", "--page", "--yes"]) == 1
    assert "--page with --yes" in capsys.readouterr().err


def test_a_third_camera_can_be_chosen(bench: Bench) -> None:
    third = FoundCamera("v4l2:usb-3", "Third", "/dev/video4")
    bench.found.append(third)
    bench.views[third.address] = bench.views[LEFT.address]
    run = Running()
    run.until(lambda s: s["chosen"])
    run.page.ask("pair", {"primary": third.address, "assistant": RIGHT.address})
    run.until(lambda s: bench.opened[-1] == (third.address, RIGHT.address))
    run.close()
