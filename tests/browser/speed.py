"""Sizes of map.html, times to its first picture, and frames a second while it turns.

`python -m tests.browser.speed`: a made-up street of 0.1, 1 and 5 million points, drawn on the CPU
at 1280x720, a row of a table each.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.report.map_page import write_map_page
from tests.browser.chromium import READY, WHOLE, chromium, program, stats, street

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SECONDS = 5.0
POINTS = 100_000, 1_000_000, 5_000_000
COLUMNS = (
    *("points", "written, s", "page, MB", "beside, MB", "first picture, s", "all loaded, s"),
    *("frames/s", "points a frame"),
)
TURN = """(seconds) => new Promise((done) => {
  const canvas = document.getElementById("map"), began = performance.now();
  const at = (type, x) => canvas.dispatchEvent(new PointerEvent(type, {pointerId: 1,
    clientX: x, clientY: 300, button: 0, buttons: 1, bubbles: true}));
  at("pointerdown", 600);
  let n = 0, drawn = 0;
  const turn = () => {
    at("pointermove", 600 + 4 * (++n % 2 ? n : n + 1));
    drawn += calmEdgeMap.stats.drawn;
    if (performance.now() - began < 1000 * seconds) requestAnimationFrame(turn);
    else {
      at("pointerup", 600);
      done([1000 * n / (performance.now() - began), drawn / n]);
    }
  };
  requestAnimationFrame(turn);
})"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, nargs="+", default=POINTS)
    parser.add_argument("--out", type=Path, default=Path("build/browser"))
    arguments = parser.parse_args()
    if program() is None:
        raise SystemExit("skipped: chromium not found")
    arguments.out.mkdir(parents=True, exist_ok=True)
    print(f"| {' | '.join(COLUMNS)} |\n|{len(COLUMNS) * '---|'}")
    with chromium() as browser:
        for points in arguments.points:
            path = (arguments.out / f"map_{points}.html").resolve()
            print(f"| {' | '.join(row(browser, path, points))} |", flush=True)


def row(browser: Browser, path: Path, points: int) -> list[str]:
    """Write a page with so many points, open it, and turn it; cells in the order of COLUMNS."""
    started = time.monotonic()
    written = write_map_page(path, street(points))
    written_s = time.monotonic() - started
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    started = time.monotonic()
    page.goto(path.as_uri(), wait_until="commit")
    page.wait_for_function(READY, timeout=120_000)
    page.wait_for_function(WHOLE, timeout=120_000)
    page.wait_for_function("calmEdgeMap.stats.loaded >= Math.min(DRIVE.count, 12e6)")
    loaded_s = time.monotonic() - started
    page.locator("#along").fill("20")
    rate, drawn = page.evaluate(TURN, SECONDS)
    first_s = stats(page)["firstPicture"] / 1000
    page.close()
    return [
        f"{points:,}",
        f"{written_s:.1f}",
        f"{written.page / 1e6:.1f}",
        f"{written.beside / 1e6:.1f}",
        f"{first_s:.2f}",
        f"{loaded_s:.1f}",
        f"{rate:.1f}",
        f"{drawn:,.0f}",
    ]


if __name__ == "__main__":
    main()
