"""Drives of the comparison `bench pixels`: real, rendered, held out, and with added faults."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.drives import DATA, DEVELOPMENT, HELD_OUT, Kilometre, Prepare, there
from bench.perturb import Clocks, Perturbation, perturbed


@dataclass(frozen=True, slots=True)
class Case:
    """A drive of the comparison.

    loose: prepares our input, with the drive's clock faults. in_step: prepares the input of
    ORB-SLAM3, the same drive with synchronised cameras; the same as `loose` without clock faults.
    counts: whether the drive enters the medians of the targets; real drives (inexact truth) and
    drives with added faults do not.
    """

    name: str
    loose: Prepare
    in_step: Prepare
    spacing_m: float
    counts: bool = True


def _rendered(drive: Kilometre) -> Case:
    return Case(drive.name, drive.loose, drive.in_step, drive.spacing_m)


def _real(name: str, folder: str, spacing_m: float) -> Case:
    return Case(name, there(DATA / folder), there(DATA / folder), spacing_m, counts=False)


def made_worse(source: Prepare, change: Perturbation) -> Prepare:
    """Prepare function of the drive `source` with faults added, in a folder of its own."""

    def prepare(out: Path) -> Path | str:
        folder = source(out)
        return folder if isinstance(folder, str) else perturbed(folder, out / "sequence", change)

    return prepare


REAL = (
    _real("karlsruhe", "karlsruhe_town", 0.5712),
    _real("kitti06", "kitti06_straight", 0.5372),
)
CASES = (*REAL, *map(_rendered, DEVELOPMENT))
UNSEEN = tuple(map(_rendered, HELD_OUT))

# Clock errors and shifted principal points on a drive without clock faults: one by one, then all.
_PLAIN = next(drive for drive in DEVELOPMENT if not drive.timing)
_CROP = ((0.03, 0.03), (-0.03, 0.03))
_FAULTS = {
    "late_20ms": Perturbation(Clocks(latency_ms=(0.0, 20.0))),
    "late_60ms": Perturbation(Clocks(latency_ms=(0.0, 60.0))),
    "early_60ms": Perturbation(Clocks(latency_ms=(60.0, 0.0))),
    "jitter_5ms": Perturbation(Clocks(jitter_ms=5.0)),
    "drift_50ppm": Perturbation(Clocks(drift_ppm=(0.0, 50.0))),
    "crop_3percent": Perturbation(crop=_CROP),
    "everything": Perturbation(Clocks((10.0, 40.0), 5.0, (0.0, 50.0)), crop=_CROP),
}
WORSE = tuple(
    Case(
        f"{_PLAIN.name}_{name}",
        made_worse(_PLAIN.loose, change),
        _PLAIN.in_step,
        _PLAIN.spacing_m,
        counts=False,
    )
    for name, change in _FAULTS.items()
)
EVERY = {case.name: case for case in (*CASES, *UNSEEN, *WORSE)}
