"""Record, optionally map, and evaluate the sequences of a dataset with the paper's settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench import steps
from bench.datasets.argoverse import ARGOVERSE
from bench.datasets.drive import Dataset, Drive, odd_even, write
from bench.datasets.kitti_360 import KITTI_360
from bench.datasets.kitti_odometry import KITTI_ODOMETRY
from calm_edge.evaluation.table import pretty
from calm_edge.types import CalmEdgeError

DATASETS: dict[str, Dataset] = {
    "kitti-odom": KITTI_ODOMETRY,
    "kitti-360": KITTI_360,
    "argoverse": ARGOVERSE,
}

# (column title, key of `eval --json`)
COLUMNS = (
    ("frames", "frames"),
    ("path m", "path_m"),
    ("covered %", "coverage_percent"),
    ("ATE m Sim(3)", "ate_sim3_m"),
    ("ATE m SE(3)", "ate_se3_m"),
    ("ATE %", "ate_percent"),
    ("focal err px", "focal_error_px"),
    ("scale mean", "scale_mean"),
    ("scale std", "scale_std"),
)
MAP_COLUMNS = (
    ("acc m", "map_accuracy_m"),
    ("comp m", "map_completeness_m"),
    ("chamfer m", "map_chamfer_m"),
)
_WIDTH = 14


@dataclass(frozen=True, slots=True)
class Wanted:
    """Options of a run on a dataset.

    asynchronous: odd frames to the primary, even to the assistant, as in the paper. frames: number
    of pairs, None for the paper's number. dense: also make a map. metric: pass the published camera
    spacing to `record`. settings: further options of `record`.
    """

    asynchronous: bool = False
    frames: int | None = None
    dense: bool = False
    metric: bool = False
    settings: tuple[str, ...] = ()


def prepare(dataset: Dataset, root: Path, name: str, wanted: Wanted, out: Path) -> Drive:
    """Load a drive and write it as the sequence folder `out`; raises DatasetError."""
    drive = dataset.load(root, name, wanted.frames or dataset.frames)
    if wanted.asynchronous:
        drive = odd_even(drive)
    write(drive, out)
    return drive


def measure(dataset: Dataset, root: Path, name: str, wanted: Wanted, out: Path) -> dict[str, Any]:
    """Record and evaluate one sequence; return its figures, with the loader's `notes`.

    Raises CalmEdgeError.
    """
    drive = prepare(dataset, root, name, wanted, out / "sequence")
    options = [*dataset.settings, *wanted.settings]
    if wanted.metric:
        options += ["--spacing-m", f"{drive.spacing_m:.6g}"]
    recording = out / "recording"
    cost = steps.record(out / "sequence", recording, options)
    target = recording
    if wanted.dense:
        target = out / "map"
        steps.dense_map(recording, target)
    figures = steps.figures(target, out / "sequence")
    return {**figures, "cpu_s": cost.cpu_s, "notes": list(drive.notes)}


def measured(
    dataset: Dataset, root: Path, names: Sequence[str], wanted: Wanted, out: Path
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Run the sequences `names` one by one and yield (name, figures).

    After a failure the figures are only its reason, under `failed`.
    """
    for name in names:
        try:
            yield name, measure(dataset, root, name, wanted, out / name)
        except CalmEdgeError as error:
            yield name, {"failed": " ".join(str(error).split())}


def columns(dense: bool) -> tuple[tuple[str, str], ...]:
    """(title, key of `eval --json`) of each column of the table. dense: with those of the map."""
    return (*COLUMNS, *MAP_COLUMNS) if dense else COLUMNS


def row(name: str, figures: Mapping[str, Any], dense: bool) -> str:
    """Format one sequence as a line of the table."""
    if "failed" in figures:
        return f"{name:<{_WIDTH}}{figures['failed']}"
    cells = [pretty(figures.get(key)) for _, key in columns(dense)]
    return f"{name:<{_WIDTH}}" + "".join(f"{cell:>{_WIDTH}}" for cell in cells)


def heading(dense: bool) -> str:
    """Format the line of column titles."""
    return f"{'sequence':<{_WIDTH}}" + "".join(f"{h:>{_WIDTH}}" for h, _ in columns(dense))


def average(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Mean of each figure over the sequences that have it.

    Of a figure with one value per eye: mean of the absolute values.
    """
    out: dict[str, Any] = {}
    for _, key in (*COLUMNS, *MAP_COLUMNS):
        values = []
        for figures in rows:
            value = figures.get(key)
            entries = value if isinstance(value, list) else [value]
            known = [abs(e) if isinstance(value, list) else e for e in entries if e is not None]
            values += known
        out[key] = float(np.mean(values)) if values else None
    return out
