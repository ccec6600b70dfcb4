"""map.html used in headless Chromium: `make browser`. Skipped, with a line, without Chromium."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.report import map_page
from calm_edge.report.events import MarkedEvent
from calm_edge.report.joined_view import joined
from calm_edge.report.map_page import FOLDER, write_map_page
from tests.browser.chromium import READY, WHOLE, Errors, chromium, program, stats, street

pytestmark = pytest.mark.skipif(program() is None, reason="chromium not found: apt install it")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "map.html"
    write_map_page(path, street(150_000))
    return path


def opened(browser: Any, path: Path, address: str = "", **options: Any) -> tuple[Any, Errors]:
    page = browser.new_page(**({"viewport": {"width": 1280, "height": 720}} | options))
    errors = Errors(page)
    page.goto(path.as_uri() + address)
    page.wait_for_function(READY)
    page.wait_for_function(WHOLE)
    return page, errors


def view(page: Any) -> list[float]:
    """Target, yaw, pitch and distance of the address; waits until it is written."""
    page.wait_for_timeout(500)
    found = re.search(r"v=([^&]*)", page.url.replace("%2C", ","))
    assert found
    return [float(v) for v in found[1].split(",")]


def coloured(page: Any) -> float:
    """Share of the map's pixels that are not the background."""
    return float(
        page.evaluate("""() => {
          const c = document.getElementById("map"), g = c.getContext("webgl2");
          const d = new Uint8Array(4 * c.width * c.height);
          g.readPixels(0, 0, c.width, c.height, g.RGBA, g.UNSIGNED_BYTE, d);
          const sky = getComputedStyle(document.documentElement).getPropertyValue("--sky").trim();
          const rgb = [1, 3, 5].map((i) => parseInt(sky.slice(i, i + 2), 16));
          let n = 0;
          for (let i = 0; i < d.length; i += 4) n += rgb.some((v, k) => Math.abs(v - d[i + k]) > 2);
          return n / (d.length / 4);
        }""")
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_it_draws_the_map_without_asking_for_anything(
    browser: Any, page_file: Path, scheme: str, width: int
) -> None:
    size = {"width": width, "height": 720}
    page, errors = opened(browser, page_file, viewport=size, color_scheme=scheme)
    assert errors == [] and all(u.startswith(("file:", "data:")) for u in errors.asked)
    assert len([u for u in errors.asked if u.startswith("file:")]) == 1
    assert "150,000 points" in page.locator("#status").inner_text()
    assert 0.005 < coloured(page) < 0.9
    # nothing sticks out of a narrow screen
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for name in ("header", "footer"):
        box = page.locator(name).bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= width
    page.close()


def test_an_event_is_listed_marked_and_leads_to_its_place(browser: Any, tmp_path: Path) -> None:
    events = [MarkedEvent(15.0, "tram crosses", 30, np.zeros(3))]
    write_map_page(tmp_path / "map.html", replace(street(20_000), events=events))
    page, errors = opened(browser, tmp_path / "map.html", viewport={"width": 390, "height": 720})
    overview = view(page)
    assert "0:15 tram crosses" in page.locator("#events").inner_text()
    page.locator("#events").select_option("30")
    chosen = view(page)
    assert chosen != overview and "keyframe 31 " in page.locator("#place").inner_text()
    page.locator("#forth").click()
    assert page.locator("#events").input_value() == ""
    page.close()
    # as the report leads there
    page, more = opened(browser, tmp_path / "map.html", "#k=31")
    assert view(page) == chosen and page.locator("#events").input_value() == "30"
    assert page.evaluate("document.documentElement.scrollWidth") <= 1280
    assert errors == [] and more == []
    page.close()


def test_the_mouse_turns_shifts_and_zooms(browser: Any, page_file: Path) -> None:
    page, errors = opened(browser, page_file)
    before = view(page)
    page.mouse.move(600, 400)
    page.mouse.down()
    page.mouse.move(700, 430, steps=4)
    page.mouse.up()
    turned = view(page)
    assert turned[3] != before[3] and turned[4] > before[4] and turned[:3] == before[:3]
    page.keyboard.down("Shift")
    page.mouse.down()
    page.mouse.move(600, 400, steps=4)
    page.mouse.up()
    page.keyboard.up("Shift")
    shifted = view(page)
    assert shifted[:3] != turned[:3] and shifted[3:] == turned[3:]
    page.mouse.wheel(0, -300)
    assert view(page)[5] < shifted[5]
    assert errors == []
    page.close()


def test_several_drives_have_their_names_and_times(browser: Any, tmp_path: Path) -> None:
    one = street(5_000)
    write_map_page(tmp_path / "map.html", joined("both", ["monday", "tuesday"], [one, one]))
    page, errors = opened(browser, tmp_path / "map.html")
    place, n = page.locator("#place"), len(one.T_w_c)
    assert place.inner_text() == f"keyframe 1 of {2 * n}, monday, 0.0 s"
    page.evaluate(f"document.getElementById('along').value = {n}")
    page.evaluate("document.getElementById('along').dispatchEvent(new Event('input'))")
    # the time is that of its own drive
    assert place.inner_text() == f"keyframe {n + 1} of {2 * n}, tuesday, 0.0 s"
    assert errors == []
    page.close()


def test_two_fingers_zoom(browser: Any, page_file: Path) -> None:
    phone = {"viewport": {"width": 390, "height": 780}, "has_touch": True, "is_mobile": True}
    page, errors = opened(browser, page_file, **phone)
    before = view(page)
    session = page.context.new_cdp_session(page)

    def fingers(kind: str, *x: int) -> None:
        points = [{"x": v, "y": 400, "id": i} for i, v in enumerate(x)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    fingers("touchStart", 150, 250)
    for spread in range(0, 100, 20):
        fingers("touchMove", 150 - spread, 250 + spread)
    fingers("touchEnd")
    after = view(page)
    assert after[5] < 0.6 * before[5] and after[3:5] == before[3:5]
    assert errors == []
    page.close()


def test_slider_and_click_show_both_pictures(browser: Any, page_file: Path) -> None:
    page, errors = opened(browser, page_file)
    assert not page.locator("#pictures").is_visible()
    page.locator("#along").fill("20")
    assert "Keyframe 21; assistant 12 ms later" in page.locator("#caption").inner_text()
    for name in ("primary", "assistant"):
        assert page.locator(f"#{name}").evaluate("(e) => e.decode().then(() => e.naturalWidth)")
    assert "k=21" in page.evaluate("new Promise((r) => setTimeout(() => r(location.href), 500))")
    page.locator("#hide").click()
    assert not page.locator("#pictures").is_visible()
    page.locator("#whole").click()
    x, y = page.evaluate("calmEdgeMap.pixelOf(DRIVE.path[40])")
    page.mouse.click(x, y)
    assert "Keyframe 41" in page.locator("#caption").inner_text()
    assert errors == []
    page.close()


def test_the_distance_of_two_points_is_measured(browser: Any, page_file: Path) -> None:
    page, errors = opened(browser, page_file)
    page.locator("#along").fill("10")
    page.locator("#hide").click()
    page.locator("#measure").click()
    # the foot of both houses, 12.7 m (5 keyframes) from each other along the street, 16 m across
    at = "(k, side) => { const p = DRIVE.path[k]; return [p[0], p[1] + side * 8, p[2] - 1.5]; }"
    for k, side in ((18, -1), (23, 1)):
        x, y = page.evaluate(f"calmEdgeMap.pixelOf(({at})({k}, {side}))")
        page.mouse.click(x, y)
    said = page.locator("#status").inner_text()
    found = re.match(r"([\d.]+) m apart", said)
    assert found, said
    truth = float(np.hypot(16, 5 * 150 / 59))
    assert abs(float(found[1]) - truth) < 0.5
    # written with the next picture
    page.wait_for_function("document.querySelector('#length').innerText !== ''")
    assert page.locator("#length").inner_text() == f"{found[1]} m"
    assert errors == []
    page.close()


def test_colours_and_view_are_in_the_link(browser: Any, page_file: Path) -> None:
    page, _ = opened(browser, page_file)
    page.locator("#along").fill("30")
    page.locator("#colors").select_option("age")
    left, address = view(page), page.url[page.url.index("#") :]
    page.close()
    page, errors = opened(browser, page_file, address)
    assert view(page) == left and page.locator("#colors").input_value() == "age"
    assert page.locator("#along").input_value() == "30"
    page.goto(page_file.as_uri() + "#v=nonsense&c=none&k=900")
    page.wait_for_timeout(300)
    assert errors == [] and stats(page)["loaded"] == 150_000
    page.close()


def red(page: Any) -> int:
    """Number of the map's pixels in the colour of the largest gaps."""
    return int(
        page.evaluate("""() => {
          const c = document.getElementById("map"), g = c.getContext("webgl2");
          const d = new Uint8Array(4 * c.width * c.height);
          g.readPixels(0, 0, c.width, c.height, g.RGBA, g.UNSIGNED_BYTE, d);
          let n = 0;
          for (let i = 0; i < d.length; i += 4) n += d[i] > 200 && d[i + 1] < 90 && d[i + 2] < 60;
          return n;
        }""")
    )


def turns(page: Any, *, seams: bool) -> bool:
    """Whether the seams come to be drawn, or to be gone, within ten seconds."""
    for _ in range(50):
        if (red(page) > 50) == seams:
            return True
        page.wait_for_timeout(200)
    return False


def test_seams_are_shown_on_demand_and_in_the_link(browser: Any, page_file: Path) -> None:
    page, errors = opened(browser, page_file)
    page.locator("#along").fill("20")
    page.locator("#hide").click()
    assert turns(page, seams=False) and "Seams" not in page.locator("#status").inner_text()
    page.locator("#seams").click()
    assert turns(page, seams=True)
    assert "disagree by 0.25 m" in page.locator("#status").inner_text()
    view(page)
    address = page.url[page.url.index("#") :]
    assert "s=1" in address
    page.locator("#seams").click()
    assert turns(page, seams=False)
    page.close()
    page, errors = opened(browser, page_file, address)
    assert turns(page, seams=True) and errors == []
    page.close()


def test_files_beside_the_page_are_loaded_and_missed(
    browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("LIMIT", 10_000), ("EMBEDDED", 5_000), ("PIECE", 10_000)):
        monkeypatch.setattr(map_page, name, value)
    write_map_page(tmp_path / "map.html", street(30_000, pictures=False))
    page, errors = opened(browser, tmp_path / "map.html")
    assert stats(page)["loaded"] == 30_000 and errors == []
    page.locator("#along").fill("3")
    assert not page.locator("#pictures").is_visible()
    page.close()
    (tmp_path / FOLDER / "0001.js").unlink()
    page = browser.new_page()
    page.goto((tmp_path / "map.html").as_uri())
    page.wait_for_function("document.getElementById('status').textContent.includes('not beside')")
    assert "15,000 of 30,000 points are shown" in page.locator("#status").inner_text()
    page.close()


def test_without_webgl_the_page_says_so(browser: Any, page_file: Path) -> None:
    page = browser.new_page()
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    errors = Errors(page)
    page.goto(page_file.as_uri())
    assert "has no WebGL2" in page.locator("#status").inner_text() and errors == []
    page.close()
