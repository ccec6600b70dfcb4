"""`make eval`: the targets of the project, measured now, a row each.

Folders that are not on this machine are said to be missing and skipped. Arguments choose rows by
a part of their name.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

SHARED = Path("../shared/data")
SIMULATED = Path("build/sim")
DEMO = Path("demo/drive")


@dataclass(frozen=True, slots=True)
class Target:
    """A drive, how it is recorded, and limits: figure -> at most. with_map: map it too."""

    name: str
    folder: Path
    options: tuple[str, ...]
    limits: dict[str, float]
    with_map: bool = False
    prepare: Callable[[Path, Path], Path] | None = None


def assistant_one_frame_late(folder: Path, scratch: Path) -> Path:
    """The folder with the first assistant image, and its time, left out."""
    late = scratch / "late"
    for eye in (0, 1):
        (late / f"cam{eye}").mkdir(parents=True)
        images = sorted((folder / f"cam{eye}").iterdir())[eye:]
        times = (folder / f"times{eye}.txt").read_text().splitlines()[eye:]
        for image in images:
            (late / f"cam{eye}" / image.name).symlink_to(image.resolve())
        (late / f"times{eye}.txt").write_text("\n".join(times) + "\n")
    return late


TARGETS = (
    Target(
        "karlsruhe_town",
        SHARED / "karlsruhe_town",
        ("--spacing-m", "0.5712"),
        {"ate_sim3_m": 1.0, "focal_error_percent": 5.0},
    ),
    Target(
        "karlsruhe_town, one eye a frame late",
        SHARED / "karlsruhe_town",
        ("--spacing-m", "0.5712"),
        {"ate_sim3_m": 1.2},
        prepare=assistant_one_frame_late,
    ),
    Target("kitti06_straight", SHARED / "kitti06_straight", (), {"ate_sim3_m": 0.2}),
    Target(
        "kitti06_straight, hinted",
        SHARED / "kitti06_straight",
        ("--hfov-deg", "82", "--spacing-m", "0.5372"),
        {"ate_se3_m": 0.6},
    ),
    Target("aalborg", SIMULATED / "aalborg", ("--spacing-m", "0.55"), {"ate_percent": 1.0}),
    Target(
        "aalborg, asynchronous",
        SIMULATED / "aalborg_async",
        ("--spacing-m", "0.55"),
        {"ate_percent": 1.2},
    ),
    Target(
        "demo drive",
        DEMO,
        ("--spacing-m", "0.5"),
        {"ate_percent": 0.5, "map_chamfer_m": 0.6},
        with_map=True,
    ),
)


def calm_edge(*arguments: object) -> str:
    """Runs the command, its progress to our stderr; its stdout. Exits with it when it fails."""
    command = [sys.executable, "-m", "calm_edge.cli", *map(str, arguments)]
    run = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if run.returncode not in (0, 3):
        raise SystemExit(f"{' '.join(command)}: exit {run.returncode}")
    return run.stdout


def measure(target: Target, scratch: Path) -> dict[str, Any]:
    """The figures of `eval --json` after a lockstep run."""
    folder = target.prepare(target.folder, scratch) if target.prepare else target.folder
    recording, result = scratch / "recording", scratch / "map"
    calm_edge(
        "record", "--sequence", folder, "--out", recording, "--pace", "lockstep", *target.options
    )
    if target.with_map:
        calm_edge("map", recording, "--out", result)
    chosen = result if target.with_map else recording
    figures = json.loads(calm_edge("eval", chosen, "--truth", target.folder, "--json"))
    assert isinstance(figures, dict)
    return figures


def worst(value: Any) -> float | None:
    """The largest absolute number of a figure; None when it has none."""
    values = value if isinstance(value, list) else [value]
    numbers = [abs(v) for v in values if isinstance(v, int | float)]
    return max(numbers, default=None)


def main(chosen: list[str]) -> int:
    """Prints a row a figure; 1 when a target is missed."""
    missed = False
    for target in TARGETS:
        if chosen and not any(part in target.name for part in chosen):
            continue
        if not (target.folder / "cam0").is_dir():
            print(f"{target.name:40} skipped: {target.folder} is not here")
            continue
        started = time.monotonic()
        with tempfile.TemporaryDirectory() as scratch:
            figures = measure(target, Path(scratch))
        for name, limit in target.limits.items():
            value = worst(figures[name])
            good = value is not None and value <= limit
            missed |= not good
            shown = "unobserved" if value is None else f"{value:.3f}"
            verdict = "ok" if good else "MISSED"
            print(f"{target.name:40} {name:20} {shown:>10}  target {limit:<5g} {verdict}")
        sigma = figures["focal_sigma_percent"]
        print(f"{target.name:40} focal sigma % {sigma}, {time.monotonic() - started:.0f} s")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
