"""A drive drawn by lot: the simulator's options, from a seed and a number."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bench.drives import Prepare, simulated

# Tracks kept for the lottery, with the length of their centre line, m. A drive starts anywhere on
# the first nine tenths.
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


@dataclass(frozen=True, slots=True)
class Drawn:
    """One drive of the lottery. spacing_m: metres between the cameras. prepare: renders it."""

    name: str
    spacing_m: float
    prepare: Prepare


def draw(seed: int, number: int) -> Drawn:
    """Drive `number` of lottery `seed`; does not depend on how many are drawn."""
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
    return Drawn(name, spacing_m, simulated(name, *words))


def _word(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"
