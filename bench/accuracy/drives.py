"""Drives of the accuracy table."""

from __future__ import annotations

from bench.drives import DATA, DEVELOPMENT, excerpt, simulated, there
from bench.outcome import Trial, trial

SPACING_M = 0.55
TRACKS, SEEDS = ("aalborg", "alpine-1", "street-1"), (5, 6)
_COMMON = "--frames 400 --width 640 --height 360 --hfov 75 70 --baseline 0.55"
# Options of the simulator, and the largest ATE asked on aalborg with the first seed, % of path.
CONDITIONS = {
    "plain": ("", 0.10),
    "off-centre": ("--centre 0.02 -0.025 -0.02 0.015", 0.12),
    "stops": ("--stop-s 12", 0.056),
    "night": ("--gain 0.12 --noise 4 --blur 3", 0.152),
}

KARLSRUHE, KITTI06 = DATA / "karlsruhe_town", DATA / "kitti06_straight"
KARLSRUHE_SPACING_M = 0.5712
FIRST, LAST = 60, 139
WHOLE = trial("karlsruhe_town", there(KARLSRUHE), KARLSRUHE_SPACING_M)
PART = trial(f"karlsruhe_town_{FIRST}_{LAST}", excerpt(KARLSRUHE, FIRST, LAST), KARLSRUHE_SPACING_M)
HINTED = trial("kitti06_hint", there(KITTI06), 0.5372, "--hfov-deg", "82")
_STREET = next(drive for drive in DEVELOPMENT if drive.name == "km_street-1")
NARROW = trial(_STREET.name, _STREET.loose, _STREET.spacing_m)


def rendered(condition: str, track: str, seed: int) -> Trial:
    """A drive under one of CONDITIONS."""
    words = f"--track {track} --seed {seed} {_COMMON} {CONDITIONS[condition][0]}".split()
    name = f"accuracy_{track}_{condition}_{seed}"
    return trial(name, simulated(name, *words), SPACING_M)
