"""Places found again on two laps: `python -m calm_edge.evaluation.model.place_table`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calm_edge.backbones.place import GradientLayout, PlaceDescriptor
from calm_edge.evaluation.drives import Prepare, pictures, simulated
from calm_edge.evaluation.model.loading import loaded
from calm_edge.evaluation.model.places import (
    PRECISION,
    SiftVlad,
    earlier,
    recall_at_one,
    same_place,
)
from calm_edge.evaluation.tables import OUT, Check, Table, publish
from calm_edge.evaluation.trajectory_file import EvaluationError, read_kitti
from calm_edge.types import Bytes, CalmEdgeError

OURS = "ours"
# At one picture a second, nothing nearer than 20 s is a return.
MIN_GAP = 20
TAUGHT_BY = 40  # pictures of another track


def _laps(track: str, frames: int, seed: int) -> Prepare:
    rig = f"--hz 1 --vmax 15 --laps 2 --blur 1 --frames {frames} --seed {seed}".split()
    return simulated(f"laps_{track}", "--track", track, *rig)


DEVELOPMENT = {"g-track-1": _laps("g-track-1", 290, 31), "brondehach": _laps("brondehach", 600, 32)}
UNSEEN = {"forza": _laps("forza", 800, 33), "e-track-6": _laps("e-track-6", 700, 34)}
# Words of the vocabulary come from a drive that is no drive of two laps.
TEACHER = simulated("aalborg", "--track", "aalborg", "--frames", "600")


def read(files: list[Path]) -> list[Bytes]:
    """Pictures (H, W, 3) BGR; raises EvaluationError."""
    out = []
    for file in files:
        image = cv2.imread(str(file), cv2.IMREAD_COLOR)
        if image is None:
            raise EvaluationError(f"{file}: not a readable image")
        out.append(np.asarray(image, np.uint8))
    return out


def measured(folder: Path, descriptors: dict[str, PlaceDescriptor]) -> dict[str, float]:
    """Recall of each on a drive, and the number of returns under ``; raises EvaluationError."""
    T_w_c = read_kitti(folder / "poses0.txt")
    images = read(pictures(folder, 0))
    same, allowed = same_place(T_w_c, MIN_GAP), earlier(len(T_w_c), MIN_GAP)
    if not same.any():
        raise EvaluationError(f"{folder}: nothing on it comes back")
    found = {"": float(same.any(1).sum())}
    for name, descriptor in descriptors.items():
        vectors = np.stack([descriptor.describe(image) for image in images])
        likeness = np.asarray(descriptor.similarity(vectors, vectors), np.float64)
        found[name] = recall_at_one(likeness, same, allowed, PRECISION)
    return found


def main(argv: list[str] | None = None) -> int:
    """Measure, print and keep the table; 1 when a promise is broken."""
    parser = argparse.ArgumentParser(
        prog="calm_edge.evaluation.model.place_table", description=__doc__
    )
    parser.add_argument("--ours", metavar="MODULE:FACTORY", help="the learned descriptor")
    parser.add_argument("--held-out", action="store_true", help="tracks nothing is tuned on")
    parser.add_argument("--only", action="append", metavar="DRIVE")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(argv)
    rows: list[tuple[Any, ...]] = []
    notes = [f"the best candidate, accepted where {100 * PRECISION:g} % of all accepted are right"]
    try:
        teacher = TEACHER(options.out)
        if isinstance(teacher, str):
            raise EvaluationError(teacher)
        files = pictures(teacher, 0)
        taught = SiftVlad(read(files[:: max(1, len(files) // TAUGHT_BY)]))
        makers: dict[str, PlaceDescriptor] = {"SIFT-VLAD": taught, "gradients": GradientLayout()}
        if options.ours:
            makers = {OURS: loaded(options.ours, "describe"), **makers}
        for name, prepare in (UNSEEN if options.held_out else DEVELOPMENT).items():
            if options.only and name not in options.only:
                continue
            print(f"{name} ...", file=sys.stderr, flush=True)
            folder = prepare(options.out)
            if isinstance(folder, str):
                notes.append(f"{name} skipped: {folder}")
                continue
            found = measured(folder, makers)
            rows.append((name, int(found[""]), *(100 * found[label] for label in makers)))
    except CalmEdgeError as error:
        print(error, file=sys.stderr)
        return 1
    checks = tuple(
        Check(f"{row[0]}: recall %, ours and SIFT-VLAD", "better", list(row[2:4]), row[2] > row[3])
        for row in rows
        if options.ours
    )
    made = Table(
        f"52_model_places{'_held_out' if options.held_out else ''}",
        "Places found again",
        f"python -m calm_edge.evaluation.model.place_table{' --held-out' * options.held_out}",
        ("drive", "returns", *(f"{label} recall %" for label in makers)),
        tuple(rows),
        checks,
        tuple(notes),
    )
    publish(made, options.out)
    return 0 if all(check.passed for check in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
