"""The page of `calm-edge setup` used in headless Chromium: `make browser`. Skipped without it."""

from __future__ import annotations

import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from calm_edge.commands import setup_page
from calm_edge.commands.setup_choices import Choices
from calm_edge.commands.setup_page import SetupPage
from calm_edge.config import Config
from calm_edge.live.access import Access, Address
from calm_edge.live.board import Board
from calm_edge.live.server import Page, Server, page_files
from calm_edge.live.wire import Message
from tests.browser.chromium import Errors, chromium, program
from tests.browser.live_in_browser import text
from tests.commands.camera_bench import LEFT, RIGHT, Bench

pytestmark = pytest.mark.skipif(program() is None, reason="chromium not found: apt install it")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


class Setup:
    """A set-up of two cameras before a wall, and the server of its page."""

    def __init__(self, folder: Path) -> None:
        board: Board[Message] = Board()
        self.path = folder / "kit.toml"
        self.page = SetupPage(Choices(Config()), self.path, board)
        content = Page(
            page_files("calm_edge.commands", "setup_files"), self.page.requests, "calm-edge setup"
        )
        self.server = Server(Address("127.0.0.1", 0), Access(), content, board, self.page.ask)
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self.page.run, args=(self._stopped,))
        self._thread.start()
        self.url = f"http://127.0.0.1:{self.server.port}/"

    def close(self) -> None:
        self._stopped.set()
        self._thread.join()
        self.server.close()


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    made = Bench()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(setup_page, "discover", made.discover)
    monkeypatch.setattr(setup_page, "live", made.live)
    monkeypatch.setattr(setup_page, "CHECK_S", 0.5)
    monkeypatch.setattr(setup_page, "LOOK_S", 0.5)
    return made


@pytest.fixture
def setup(bench: Bench, tmp_path: Path) -> Iterator[Setup]:
    made = Setup(tmp_path)
    yield made
    made.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1280])
def test_both_cameras_are_shown_judged_and_written(
    browser: Any, setup: Setup, width: int, scheme: str
) -> None:
    page = browser.new_page(viewport={"width": width, "height": 844}, color_scheme=scheme)
    errors = Errors(page)
    page.goto(setup.url)
    text(page, "#lights", "overlap")
    assert text(page, "#sentence", "fine") == "Both cameras are fine."
    for eye in ("primary", "assistant"):
        page.wait_for_function(
            "id => document.getElementById(id).src.startsWith('data:image/jpeg')", arg=eye
        )
        assert page.evaluate("id => document.getElementById(id).naturalWidth", eye) > 100
    left, right = (page.locator(f"#{eye}").bounding_box() for eye in ("primary", "assistant"))
    assert (left["y"] == right["y"]) == (width > 900)
    page.locator("#swap").click()
    text(page, "#primary-note", RIGHT.address)
    # a length that cannot be meant stays to be mended, with the reason
    page.locator("#spacing").fill("52")
    page.locator("#spacing").press("Tab")
    text(page, "#spacing-note", "10 m can be meant")
    assert page.locator("#spacing").get_attribute("aria-invalid") == "true"
    page.locator("#spacing").fill("52 cm")
    page.locator("#spacing").press("Tab")
    text(page, "#keys", "scale.spacing_m = 0.52")
    page.locator("#gps").fill("gpsd")
    page.locator("#gps").press("Tab")
    text(page, "#keys", 'gps.source = "gpsd"')
    page.locator("#write").click()
    text(page, "#path", "is written")
    written = tomllib.loads(setup.path.read_text())
    assert written["capture"] == {"primary": RIGHT.address, "assistant": LEFT.address}
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("write", "finish", "swap", "cover", "speed"):
        box = page.locator(f"#{name}").bounding_box()
        assert box["height"] >= 44 and box["x"] >= 0 and box["x"] + box["width"] <= width
    page.locator("#finish").click()
    text(page, "#sentence", "To record: calm-edge record")
    assert page.locator("#write").is_disabled()
    # what was refused is logged by the browser as an error
    assert all("409" in error for error in errors)
    assert all(url.startswith((setup.url, "data:")) for url in errors.asked)
    page.close()


def test_a_missing_camera_is_asked_for_and_the_primary_chosen_from_a_list(
    browser: Any, bench: Bench, tmp_path: Path
) -> None:
    bench.found.remove(RIGHT)
    setup = Setup(tmp_path)
    page = browser.new_page(viewport={"width": 390, "height": 844})
    page.goto(setup.url)
    text(page, "#sentence", "1 of 2 cameras found. Plug in two USB cameras")
    assert page.locator("#swap").is_disabled() and page.locator("#state.bad").count() == 1
    bench.found.append(RIGHT)
    text(page, "#primary-note", LEFT.address)
    # the other one takes its place
    page.locator("#choose-primary").select_option(RIGHT.address)
    text(page, "#primary-note", RIGHT.address)
    assert page.locator("#choose-assistant").input_value() == LEFT.address
    page.close()
    setup.close()
