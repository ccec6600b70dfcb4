"""Headless Chromium with software rendering, and a made-up street to look at in it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from calm_edge.report.keyframe_pictures import KeyframePictures
from calm_edge.report.map_page import MapView
from calm_edge.types import Float32
from device.frame import jpeg

if TYPE_CHECKING:
    from playwright.sync_api import Browser

KEYFRAMES, LENGTH = 60, 150.0
OPTIONS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
READY = "window.calmEdgeMap && calmEdgeMap.stats && calmEdgeMap.stats.firstPicture !== null"
WHOLE = "calmEdgeMap.stats.drawn >= Math.min(DRIVE.count, 2e6)"


class Errors(list[str]):
    """What a page reports as wrong, and every address that it asks for."""

    def __init__(self, page: Any) -> None:
        super().__init__()
        self.asked: list[str] = []
        page.on("pageerror", lambda e: self.append(str(e)))
        page.on("console", lambda m: self.append(m.text) if m.type == "error" else None)
        page.on("request", lambda r: self.asked.append(r.url))


def program() -> str | None:
    """Path of Chromium, None without it."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser that draws on the CPU."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=program(), args=list(OPTIONS))
        yield browser
        browser.close()


def street(points: int, pictures: bool = True) -> MapView:
    """A straight street between two houses, 16 wide, driven along z."""
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (KEYFRAMES, 1, 1))
    T[:, 2, 3] = np.linspace(0, LENGTH, KEYFRAMES)
    wall = rng.uniform(size=points) < 0.5
    side = np.where(rng.uniform(size=points) < 0.5, -8.0, 8.0)
    p = np.empty((points, 3), np.float32)
    p[:, 0] = np.where(wall, side, rng.uniform(-8, 8, points))
    p[:, 1] = np.where(wall, rng.uniform(-8, 1.5, points), 1.5)
    p[:, 2] = rng.uniform(0, LENGTH, points)
    color = np.where(wall[:, None], [170, 120, 90], [95, 95, 100]).astype(np.uint8)
    submap = (p[:, 2] / LENGTH * 5.999).astype(np.int64)
    shown = [KeyframePictures(k, _plain(k), _plain(255 - k), 12_000_000) for k in range(KEYFRAMES)]
    return MapView(
        "drives/street", "m", 0.08, p, color, submap, np.arange(6) * 5.0, T,
        np.arange(KEYFRAMES) / 2, shown if pictures else (), seams(),
    )  # fmt: skip


def seams(count: int = 500) -> Float32:
    """Places on the road (count, 4) at the middle of the street, the gap 0 to 0.5 m along it."""
    marks = np.zeros((count, 4), np.float32)
    marks[:, 0] = np.random.default_rng(1).uniform(-6, 6, count)
    marks[:, 1], marks[:, 2] = 1.4, np.linspace(60, 90, count)
    marks[:, 3] = np.linspace(0, 0.5, count)
    return marks


def _plain(level: int) -> bytes:
    return jpeg(np.full((90, 160, 3), level, np.uint8))


def stats(page: Any) -> dict[str, Any]:
    """The viewer's counts: firstPicture [ms since navigation], frames, drawn, loaded."""
    return dict(page.evaluate("calmEdgeMap.stats"))
