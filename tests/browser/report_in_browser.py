"""report.html used in headless Chromium: `make browser`. Skipped, with a line, without Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calm_edge.evaluation.estimate import from_updates
from calm_edge.report.drive_log import DriveLog, HealthSeries, Lost
from calm_edge.report.drive_report import report_data
from calm_edge.report.report import write_report
from calm_edge.types import LocalizerUpdate
from tests.browser.chromium import Errors, chromium, program
from tests.evaluation.worlds import curve, stamps, update

pytestmark = pytest.mark.skipif(program() is None, reason="chromium not found: apt install it")
N = 160
LEAST_TEXT_PX = 10


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as found:
        yield found


def updates() -> list[LocalizerUpdate]:
    T, t = curve(N), stamps(N)
    return [
        update(T[: 40 * (k + 1) : 4], t[: 40 * (k + 1) : 4], submap_id=k, stage_ms={"infer": 120.0})
        for k in range(4)
    ]


@pytest.fixture(scope="module")
def page_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    rng = np.random.default_rng(0)
    base = curve(N)[rng.integers(0, N, 6000), :3, 3]
    points = (base + rng.normal(0, [3, 0.02, 3], (6000, 3)) + [0, 1.5, 0]).astype(np.float32)
    estimate = replace(from_updates("r", updates(), N, 0.5), points_w=points)
    t = np.arange(60.0)
    health = HealthSeries(t, 50 + t / 4, 90 - t / 60, 0 * t + 2.1, 0 * t + 80, 0 * t)
    log = DriveLog(1.7e9, "synchronised", 61.0, (N, N), "0.1.0", {"finished": True})
    log = replace(log, health=health, lost=(Lost(20.0, 12.0, "primary: too dark"),))
    color = np.full((6000, 3), (200, 30, 30), np.uint8)
    street = np.full((360, 640, 3), 90, np.uint8)
    data = report_data(
        "drives/a-drive-with-a-rather-long-name", estimate, updates(), color,
        pictures=[street, street], log=log,
    )  # fmt: skip
    (folder / "map.ply").touch()
    write_report(folder / "report.html", replace(data, files=(folder / "map.ply",)))
    return folder / "report.html"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_it_can_be_read_on_a_desk_and_on_a_phone(
    browser: Any, page_file: Path, scheme: str, width: int
) -> None:
    page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
    errors = Errors(page)
    page.goto(page_file.as_uri())
    assert errors == [] and [u for u in errors.asked if not u.startswith("data:")] == [page.url]
    # nothing sticks out, and no frame has to be scrolled sideways
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    wide = "[...document.querySelectorAll('section')].filter((s) => s.scrollWidth > s.clientWidth)"
    assert page.evaluate(f"{wide}.map((s) => s.querySelector('h2').innerText)") == []
    # one of the two drawings of each chart is shown, with text of a size to read
    heights = """[...document.querySelectorAll('svg text')].map(
      (t) => t.getBoundingClientRect().height).filter((h) => h > 0)"""
    shown = page.evaluate(heights)
    assert len(shown) > 50 and min(shown) >= LEAST_TEXT_PX
    assert page.locator(".wide").first.is_visible() == (width == 1280)
    assert page.locator(".narrow").first.is_visible() == (width == 390)
    # what happened comes first, and is in view without scrolling
    account = page.locator("p.account")
    assert "12.0 s at 0:20 (primary: too dark)" in account.inner_text()
    assert account.bounding_box()["y"] < 300
    page.close()


def test_colours_follow_the_scheme(browser: Any, page_file: Path) -> None:
    luminance = {}
    for scheme in ("light", "dark"):
        page = browser.new_page(color_scheme=scheme)
        page.goto(page_file.as_uri())
        rgb = """(e) => getComputedStyle(e).getPropertyValue(%r).match(/\\d+/g).slice(0, 3)
          .reduce((a, b) => a + Number(b), 0) / 3"""
        card = page.locator("section").first.evaluate(rgb % "background-color")
        text = page.locator("svg text:visible").first.evaluate(rgb % "fill")
        luminance[scheme] = card - text
        page.close()
    # dark text on light cards, light text on dark ones, each with contrast
    assert luminance["light"] > 100 and luminance["dark"] < -100


def test_links_lead_to_the_files_beside_the_page(browser: Any, page_file: Path) -> None:
    page = browser.new_page()
    page.goto(page_file.as_uri())
    address = page.locator("a", has_text="map.ply").evaluate("(a) => a.href")
    assert address == (page_file.parent / "map.ply").as_uri()
    page.close()
