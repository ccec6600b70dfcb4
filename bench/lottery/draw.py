"""Draw a drive, as options of the simulator, at random from a seed and a number."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bench.drives import simulated
from bench.outcome import Trial, trial

# Tracks of the simulator used for these drives only: name -> length of the centre line, m. The
# start is drawn from the first nine tenths, less 150 m for the drive itself. dirt-1 is left out:
# pillow, by which the simulator reads textures, does not open one of its (SGI, grey with alpha).
TRACKS = {
    "corkscrew": 3606,
    "e-track-1": 3245,
    "e-track-4": 7039,
    "eroad": 3254,
    "g-track-2": 3186,
    "spring": 22136,
    "wheel-1": 4330,
    "dirt-2": 1764,
    "mixed-1": 1012,
    "michigan": 2311,
}
FRAMES = 120
SIZE = (640, 360)
SPACING_M = (0.25, 1.0)
HFOV_DEG = (62.0, 95.0)
MOST_TURNED_DEG = 4.0


def draw(seed: int, number: int) -> Trial:
    """Draw drive `number` of the series `seed`; it depends on these two only."""
    rng = np.random.default_rng([seed, number])
    track = list(TRACKS)[int(rng.integers(len(TRACKS)))]
    start_m = rng.uniform(0, 0.9 * TRACKS[track] - 150)
    spacing_m = round(rng.uniform(*SPACING_M), 4)
    hfov = rng.uniform(*HFOV_DEG, 2)
    turned = rng.uniform(-MOST_TURNED_DEG, MOST_TURNED_DEG, 3)
    options: dict[str, Iterable[float | str]] = {
        "--track": [track],
        "--skip-s": [start_m],
        "--frames": [FRAMES],
        "--width": SIZE[:1],
        "--height": SIZE[1:],
        "--hfov": hfov,
        "--baseline": [spacing_m],
        "--rot-deg": turned,
        "--seed": [int(rng.integers(1 << 31))],
    }
    words = [w for key, values in options.items() for w in (key, *(_word(v) for v in values))]
    name = f"lottery_plain_{seed}_{number:02d}"
    return trial(name, simulated(name, *words), spacing_m)


def _word(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"
