"""Place recognition on drives of two laps: recall at a fixed precision."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.drives import Prepare, pictures, simulated
from bench.model.match_table import OURS, ratio_check
from bench.model.ours import contestant
from bench.model.places import (
    PRECISION,
    SiftVlad,
    earlier,
    found_again,
    same_place,
)
from bench.paired import compare
from bench.tables import OUT, Check, Table, publish
from calm_edge.evaluation.errors import EvaluationError
from calm_edge.loops.descriptor import GradientLayout, PlaceDescriptor
from calm_edge.trajectories import read_kitti
from calm_edge.types import Bytes

RIVAL = "SIFT-VLAD"
# At one picture a second, nothing nearer than 20 s is a return.
MIN_GAP = 20
TAUGHT_BY = 40  # pictures of another track
# A drive's returns in so many stretches of as many: the pairs of the interval.
STRETCHES = 6


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


def measured(folder: Path, descriptors: dict[str, PlaceDescriptor]) -> dict[str, NDArray[np.bool_]]:
    """Of each, whether it found a return, (R,) in their order; raises EvaluationError."""
    T_w_c = read_kitti(folder / "poses0.txt")
    images = read(pictures(folder, 0))
    same, allowed = same_place(T_w_c, MIN_GAP), earlier(len(T_w_c), MIN_GAP)
    returns = same.any(1)
    if not returns.any():
        raise EvaluationError(f"{folder}: nothing on it comes back")
    found = {}
    for name, descriptor in descriptors.items():
        vectors = np.stack([descriptor.describe(image) for image in images])
        likeness = np.asarray(descriptor.similarity(vectors, vectors), np.float64)
        found[name] = found_again(likeness, same, allowed, PRECISION)[returns]
    return found


def promises(found: Mapping[str, Mapping[str, NDArray[np.bool_]]]) -> tuple[Check, ...]:
    """Ours finds more returns than RIVAL, paired over drives' stretches; found: by drive and name.

    Nothing where ours took no part.
    """
    recall: dict[str, dict[tuple[str, int], float | None]] = {OURS: {}, RIVAL: {}}
    for drive, by_name in found.items():
        for name in recall.keys() & by_name.keys():
            for k, stretch in enumerate(np.array_split(by_name[name], STRETCHES)):
                # half a return away from none and all, so that ratios exist
                recall[name][drive, k] = float((stretch.sum() + 0.5) / (len(stretch) + 1))
    if not recall[OURS]:
        return ()
    what = f"recall of {RIVAL} over ours, {len(found)} drives"
    return tuple(ratio_check(what, compare(recall[RIVAL], recall[OURS]), 1.0))


def configure(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument("--ours", metavar="MODULE:FACTORY", help="the learned descriptor")
    parser.add_argument("--held-out", action="store_true", help="tracks nothing is tuned on")
    parser.add_argument("--only", action="append", metavar="DRIVE")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Measure, print and keep the table; 1 when a promise is broken."""
    rows: list[tuple[Any, ...]] = []
    found: dict[str, dict[str, NDArray[np.bool_]]] = {}
    notes = [f"the best candidate, accepted where {100 * PRECISION:g} % of all accepted are right"]
    teacher = TEACHER(options.out)
    if isinstance(teacher, str):
        raise EvaluationError(teacher)
    files = pictures(teacher, 0)
    taught = SiftVlad(read(files[:: max(1, len(files) // TAUGHT_BY)]))
    makers: dict[str, PlaceDescriptor] = {RIVAL: taught, "gradients": GradientLayout()}
    ours, missing = contestant(options.ours, "describe")
    if ours is not None:
        makers = {OURS: ours, **makers}
    else:
        notes.append(missing)
    for name, prepare in (UNSEEN if options.held_out else DEVELOPMENT).items():
        if options.only and name not in options.only:
            continue
        print(f"{name} ...", file=sys.stderr, flush=True)
        folder = prepare(options.out)
        if isinstance(folder, str):
            notes.append(f"{name} skipped: {folder}")
            continue
        again = found[name] = measured(folder, makers)
        recalls = (100 * float(again[label].mean()) for label in makers)
        rows.append((name, len(again[RIVAL]), *recalls))
    made = Table(
        f"52_model_places{'_held_out' if options.held_out else ''}",
        "Places found again",
        f"python -m bench model.places{' --held-out' * options.held_out}",
        ("drive", "returns", *(f"{label} recall %" for label in makers)),
        tuple(rows),
        promises(found),
        tuple(notes),
    )
    return publish(made, options.out)
