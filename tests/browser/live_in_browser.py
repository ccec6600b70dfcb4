"""The live page used in headless Chromium: `make browser`. Skipped, with a line, without it."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from calm_edge.config import Config, merge
from calm_edge.daemon.live_output import LiveOutput
from calm_edge.daemon.messages import Event, Keep
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing, State
from calm_edge.live.access import Access, Address
from calm_edge.live.board import Board
from calm_edge.live.server import Server, live_page
from calm_edge.live.source import Source
from calm_edge.live.wire import Message
from calm_edge.recording.health import Space, WriterHealth
from calm_edge.types import Masks, PoseStatus, Trajectory
from device.frame import Eye, Frame
from tests.browser.chromium import chromium, program
from tests.browser.map_in_browser import Errors
from tests.daemon.test_health import HEALTH
from tests.daemon.test_live_output import straight
from tests.live.test_plan import at
from tests.recording import samples

pytestmark = pytest.mark.skipif(program() is None, reason="chromium not found: apt install it")
TOKEN = "token-of-this-test"
GIB = 1 << 30


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


class Car:
    """A recording, the page's server, and a browser's page that shows it."""

    def __init__(self, folder: Path, token: str = "") -> None:
        path = folder / "live.sock"
        config = merge(Config(), {"live": {"socket": str(path)}, "scale": {"spacing_m": 0.5}})
        self.output = LiveOutput(config, time.monotonic_ns)
        self.board: Board[Message] = Board()
        self.source = Source(path, self.board)
        address = Address("127.0.0.1", 0)
        self.server = Server(address, Access(token), live_page(), self.board, self.source.ask)
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()
        self.until(lambda: self.output.readers == 1)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.port}/"

    def until(self, condition: Callable[[], Any]) -> None:
        end = time.monotonic() + 30
        while not condition():
            assert time.monotonic() < end, "never happened"
            time.sleep(0.02)

    def drive(self, kept: bool = False) -> None:
        """Everything that there is while driving."""
        self.status(State.RUNNING, kept=kept)
        base = straight(np.random.default_rng(0).uniform([-8, -2, 8], [8, 1, 40], (300, 3)))
        T = np.stack([at(3 * np.sin(z / 9), 0, z) for z in np.arange(0, 60, 1.5)])
        ids = np.arange(len(T))
        mask = np.zeros((18, 32), np.uint8)
        mask[14:] = 1
        for step in (20, len(T)):
            moved = Trajectory(ids[:step], ids[:step], T[:step], base.trajectory.T_p_a, 0)
            sigma = np.array([0.2, 0.3]) / step
            submap = dataclasses.replace(
                base.submap, focal_log_sigma=sigma, t_ns=base.submap.t_ns + step * 10**9
            )
            self.output.update(
                dataclasses.replace(
                    base, submap=submap, trajectory=moved, masks=Masks(mask, None)
                )
            )  # fmt: skip
        self.output.event(Event(0, "tram crosses"))
        self.output.say(30, "window 3: only 2 assistant frames", "daemon")
        picture = cv2.imencode(".jpg", np.full((480, 640, 3), 90, np.uint8))[1].tobytes()
        sample = dataclasses.replace(
            samples.pose(), t_ns=samples.T0_NS, T_w_c=T[-1], status=PoseStatus.LIVE,
            velocity_c=np.array([0, 0, 10.0]), turn_rate_c=np.zeros(3),
        )  # fmt: skip
        self.output.pose(sample, 0)
        self.output._moves_s = time.monotonic()
        self.output.frame(Frame(Eye.PRIMARY, 0, samples.T0_NS, picture))
        uv = np.random.default_rng(1).uniform(50, 400, (80, 2))
        self.output.moves(samples.T0_NS, np.hstack([uv, uv - [6, 2]]).astype(np.float32))
        self.output._points_w += [0, 0, 60]
        self.output.frame(Frame(Eye.ASSISTANT, 0, samples.T0_NS, picture))

    def status(self, state: State, *reasons: str, kept: bool = False) -> None:
        writer = WriterHealth("", 0, 0, 0, 0.0, 1.0, Space(62 * GIB, 2 * GIB, 6e6), kept)
        standing = Standing(state, reasons)
        self.output.status(standing, dataclasses.replace(HEALTH, standing=standing, writer=writer))

    def close(self) -> None:
        self.output.close(RecordResult())
        self.source.close()
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def car(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Car]:
    monkeypatch.setattr("calm_edge.live.source.RETRY_S", 0.1)
    car = Car(tmp_path)
    yield car
    car.close()


def opened(browser: Any, car: Car, **options: Any) -> tuple[Any, Errors]:
    page = browser.new_page(**({"viewport": {"width": 390, "height": 844}} | options))
    errors = Errors(page)
    page.goto(car.url)
    return page, errors


def text(page: Any, selector: str, contains: str) -> str:
    """Text of an element once it contains something."""
    page.wait_for_function(
        "([s, t]) => document.querySelector(s).textContent.includes(t)", arg=[selector, contains]
    )
    return str(page.locator(selector).inner_text())


def near(page: Any, canvas: str, rgb: tuple[int, int, int], share: float = 0.15) -> int:
    """Number of a canvas' pixels that are nearly of a colour."""
    return int(
        page.evaluate(
            """([id, rgb, share]) => {
              const c = document.getElementById(id), g = c.getContext("2d");
              const d = g.getImageData(0, 0, c.width, c.height).data;
              let n = 0;
              for (let i = 0; i < d.length; i += 4) {
                n += d[i + 3] > 0 && rgb.every((v, k) => Math.abs(v - d[i + k]) < 255 * share);
              }
              return n;
            }""",
            [canvas, list(rgb), share],
        )
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_it_shows_the_drive_at_every_size_and_asks_for_nothing_elsewhere(
    browser: Any, car: Car, width: int, scheme: str
) -> None:
    size = {"width": width, "height": 844}
    page, errors = opened(browser, car, viewport=size, color_scheme=scheme)
    text(page, "#sentence", "not known yet")
    car.drive()
    assert text(page, "#sentence", "pose is live").startswith("Recording, and the pose is live")
    assert page.locator("#state").get_attribute("class") == "good"
    text(page, "#primary-note", "80 points tracked")
    text(page, "#assistant-note", "points of the map")
    assert "61 °C" in text(page, "#celsius", "°C") and "left" in text(page, "#disk", "GB free")
    rows = text(page, "#eyes", "assistant")
    assert "500 px" in rows and "0.5 %" in rows and "0.8 %" in rows
    assert "m" in text(page, "#length", "6") and "36 km/h" in text(page, "#pose-note", "live")
    text(page, "#events", "tram crosses")
    text(page, "#notes", "only 2 assistant frames")
    page.wait_for_timeout(200)
    # tracks and the mask on the primary's picture, points on the assistant's
    green, yellow, red = (53, 224, 161), (255, 211, 77), (143, 77, 75)
    assert near(page, "primary", green) > 300 and near(page, "primary", red, 0.04) > 3000
    assert near(page, "assistant", yellow) > 50 and near(page, "assistant", red, 0.04) < 100
    blue = (11, 107, 203) if scheme == "light" else (90, 169, 245)
    # both focal lengths are the same here: the assistant's is drawn above
    purple = (160, 61, 143) if scheme == "light" else (217, 138, 201)
    assert near(page, "plan", blue) > 200 and near(page, "focal", purple) > 50
    # nothing sticks out of a narrow screen, and the buttons are large enough for a thumb
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("mark", "keep"):
        box = page.locator(f"#{name}").bounding_box()
        assert box["height"] >= 48 and box["x"] >= 0 and box["x"] + box["width"] <= width
    assert errors == [] and all(u.startswith((car.url, "data:")) for u in errors.asked)
    page.close()


def test_the_state_changes_with_its_reason(browser: Any, car: Car) -> None:
    page, errors = opened(browser, car)
    for state, level, word in (
        (State.STARTING, "warning", "without a pose"),
        (State.LOST, "bad", "pose is lost"),
        (State.DEGRADED, "bad", "with a fault"),
        (State.STOPPING, "warning", "last windows"),
    ):
        car.status(state, "the camera is unplugged")
        assert "the camera is unplugged" in text(page, "#sentence", word)
        assert page.locator("#state").get_attribute("class") == level
        assert page.locator("#word").inner_text() == state.value
    assert errors == []
    page.close()


def test_buttons_mark_an_event_and_protect_the_drive(browser: Any, car: Car) -> None:
    page, errors = opened(browser, car)
    car.drive()
    text(page, "#frames", "600")
    asked: list[Event | Keep] = []
    page.locator("#mark").click()
    assert text(page, "#answer", "marked") == "Event marked."
    page.locator("#keep").click()
    text(page, "#answer", "not be deleted")
    car.until(lambda: asked.extend(car.output.requests()) or len(asked) >= 2)
    assert isinstance(asked[0], Event) and asked[1] == Keep(True)
    # pressed once the recorder has done it
    assert page.locator("#keep").get_attribute("aria-pressed") == "false"
    car.status(State.RUNNING, kept=True)
    text(page, "#keep", "Protected")
    assert page.locator("#keep").get_attribute("aria-pressed") == "true"
    page.locator("#keep").click()
    text(page, "#answer", "No longer protected")
    car.until(lambda: asked.extend(car.output.requests()) or asked[2:] == [Keep(False)])
    assert errors == []
    page.close()


def test_the_end_of_a_recording_and_the_next_one_are_shown(browser: Any, tmp_path: Path) -> None:
    car = Car(tmp_path)
    page, errors = opened(browser, car)
    car.drive()
    text(page, "#events", "tram crosses")
    car.output.close(RecordResult(frames=[10, 0]))
    assert "no frame of the assistant camera" in text(page, "#sentence", "ended")
    assert page.locator("#mark").is_disabled()
    config = merge(Config(), {"live": {"socket": str(tmp_path / "live.sock")}})
    car.output = LiveOutput(config, time.monotonic_ns)
    car.status(State.STARTING, "no sub-map yet")
    text(page, "#sentence", "no sub-map yet")
    assert page.locator("#events").is_hidden() and page.locator("#mark").is_enabled()
    assert page.locator("#length").inner_text() == ""
    assert errors == []
    car.close()
    text(page, "#sentence", "No connection")
    page.close()


def test_the_address_with_the_token_opens_the_page_and_loses_the_token(
    browser: Any, tmp_path: Path
) -> None:
    car = Car(tmp_path, TOKEN)
    page = browser.new_context().new_page()
    assert page.goto(car.url).status == 401
    page.goto(f"{car.url}?token={TOKEN}")
    assert page.url == car.url
    text(page, "#sentence", "Recording")
    page.reload()
    text(page, "#sentence", "Recording")
    page.locator("#mark").click()
    text(page, "#answer", "Event marked")
    page.close()
    car.close()
