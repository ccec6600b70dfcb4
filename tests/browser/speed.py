"""Size of a map's page, time to its first picture, and frames a second while it turns.

`python -m tests.browser.speed --points 5000000`: a made-up street, drawn on the CPU at 1280x720.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from calm_edge.report.map_page import write_map_page
from tests.browser.chromium import READY, WHOLE, chromium, program, stats, street

SECONDS = 5.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=int, default=5_000_000)
    parser.add_argument("--out", type=Path, default=Path("build/browser"))
    arguments = parser.parse_args()
    if program() is None:
        raise SystemExit("skipped: chromium not found")
    arguments.out.mkdir(parents=True, exist_ok=True)
    path = (arguments.out / "map.html").resolve()
    started = time.monotonic()
    print(f"written        {write_map_page(path, street(arguments.points))}")
    print(f"writing        {time.monotonic() - started:.1f} s")
    with chromium() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 720})
        page.goto(path.as_uri(), wait_until="commit")
        page.wait_for_function(READY, timeout=120_000)
        print(f"first picture  {stats(page)['firstPicture'] / 1000:.2f} s")
        started = time.monotonic()
        page.wait_for_function(WHOLE, timeout=120_000)
        page.wait_for_function("calmEdgeMap.stats.loaded >= Math.min(DRIVE.count, 12e6)")
        print(f"all loaded     {time.monotonic() - started:.1f} s later")
        page.locator("#along").fill("20")
        turned = page.evaluate(
            """(seconds) => new Promise((done) => {
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
            })""",
            SECONDS,
        )
        print(f"turning        {turned[0]:.1f} frames/s, {turned[1]:,.0f} points each")


if __name__ == "__main__":
    main()
