"""Draw a drive, as options of the simulator, at random from a seed and a number.

A drive is plain, of pinhole pictures, or real: with lenses, rolling shutters, clocks apart, a
bonnet, traffic or night, as a kit in a car has them.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bench.drives import simulated
from bench.outcome import Trial, trial
from calm_edge.types import Float

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
KINDS = ("plain", "real")
# Real ones: share of fisheye lenses, with the simulator's --hfov of 84 to 116 degrees across;
# radial terms of the others; k2 in -k1; share of the radius up to which a lens must be invertible.
FISHEYE_SHARE, FISHEYE_HFOV_DEG, FISHEYE_K1 = 0.33, (72.5, 90.5), 0.01
RADIAL_K1, K2_SHARE, INVERTIBLE = (-0.2, 0.03), 0.25, 1.1
READOUT_MS, MOST_OFF_CENTRE, MOST_ASYNC_S, MOST_JITTER_MS = (8.0, 32.0), 0.02, 0.05, 2.0
BONNET, TRAFFIC, NIGHT_SHARE = (0.05, 0.18), (6, 37), 0.2


def draw(seed: int, number: int, kind: str = "plain") -> Trial:
    """Draw drive `number` of the series `seed`, of one of KINDS; it depends on these only.

    A real drive has the place and the rig of the plain one.
    """
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
    if kind == "real":
        options |= _of_a_real_kit(rng, hfov)
    words = [w for key, values in options.items() for w in (key, *(_word(v) for v in values))]
    name = f"lottery_{kind}_{seed}_{number:02d}"
    return trial(name, simulated(name, *words), spacing_m)


def _of_a_real_kit(rng: np.random.Generator, hfov: Float) -> dict[str, Iterable[float | str]]:
    """What a real kit adds, or has instead. hfov: (2,) degrees of the plain drive."""
    out: dict[str, Iterable[float | str]] = {}
    if rng.random() < FISHEYE_SHARE:
        out["--hfov"], out["--fisheye"], out["--ss"] = rng.uniform(*FISHEYE_HFOV_DEG, 2), [], [1]
        k1, k2 = rng.uniform(-FISHEYE_K1, FISHEYE_K1, 2), np.zeros(2)
    else:
        k1 = np.maximum(rng.uniform(*RADIAL_K1, 2), _least_radial(hfov))
        k2 = np.where(k1 < 0, -K2_SHARE * k1, 0.0)
    out["--lens0"], out["--lens1"] = ([k1[eye], k2[eye], 0, 0] for eye in (0, 1))
    out["--readout-ms"] = rng.uniform(*READOUT_MS, 2)
    out["--centre"] = rng.uniform(-MOST_OFF_CENTRE, MOST_OFF_CENTRE, 4)
    out["--async"] = [rng.uniform(-MOST_ASYNC_S, MOST_ASYNC_S)]
    out["--jitter-ms"] = [rng.uniform(0, MOST_JITTER_MS)]
    if rng.random() < 0.5:
        out["--bonnet"] = [rng.uniform(*BONNET)]
    if rng.random() < 0.5:
        out["--traffic"] = [int(rng.integers(*TRAFFIC))]
    if rng.random() < NIGHT_SHARE:
        out["--gain"], out["--noise"], out["--blur"] = [0.12], [4], [3]
    return out


def _least_radial(hfov_deg: Float) -> Float:
    """Least k1 (2,) at which r + k1 r^3 still grows where it shows the corners of the picture.

    Its largest value is two thirds of (-3 k1) ** -0.5.
    """
    width, height = SIZE
    corner = np.tan(np.radians(hfov_deg) / 2) * np.hypot(width, height) / width
    return np.asarray(-4 / 27 / (INVERTIBLE * corner) ** 2)


def _word(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.10g}"
