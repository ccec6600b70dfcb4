"""Place recognition on drives of two laps: recall at a fixed precision."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.drives import Prepare, pictures, read_picture, simulated
from bench.model.match_table import ratio_check
from bench.model.ours import OURS, add_arguments, contestant
from bench.model.places import (
    PRECISION,
    SiftVlad,
    earlier,
    found_again,
    same_place,
)
from bench.model.scenes import prepared
from bench.paired import compare
from bench.tables import Check, Table, publish
from calm_edge.evaluation import EvaluationError
from calm_edge.loops.descriptor import GradientLayout, PlaceDescriptor
from calm_edge.trajectories import read_kitti

RIVAL = "SIFT-VLAD"
# Least number of pictures, one per second, between two pictures that count as separate visits.
MIN_GAP = 20
TRAINING_PICTURES = 40
# The returns of a drive are split into this number of stretches, the pairs of the comparison.
STRETCHES = 6


def _laps(track: str, frames: int, seed: int) -> Prepare:
    rig = f"--hz 1 --vmax 15 --laps 2 --blur 1 --frames {frames} --seed {seed}".split()
    return simulated(f"laps_{track}", "--track", track, *rig)


DEVELOPMENT = {"g-track-1": _laps("g-track-1", 290, 31), "brondehach": _laps("brondehach", 600, 32)}
UNSEEN = {"forza": _laps("forza", 800, 33), "e-track-6": _laps("e-track-6", 700, 34)}
# Drive for training the visual words, on a track of its own.
TRAINING = simulated("aalborg", "--track", "aalborg", "--frames", "600")


def measured(folder: Path, descriptors: dict[str, PlaceDescriptor]) -> dict[str, NDArray[np.bool_]]:
    """For each descriptor, by name, the mask (R,) of returns to a place that it recognises.

    A return is a picture of a place visited earlier. Raises EvaluationError if there is none.
    """
    T_w_c = read_kitti(folder / "poses0.txt")
    images = [read_picture(file) for file in pictures(folder, 0)]
    same, allowed = same_place(T_w_c, MIN_GAP), earlier(len(T_w_c), MIN_GAP)
    returns = same.any(1)
    if not returns.any():
        raise EvaluationError(f"{folder}: no place is visited twice")
    found = {}
    for name, descriptor in descriptors.items():
        vectors = np.stack([descriptor.describe(image) for image in images])
        likeness = np.asarray(descriptor.similarity(vectors, vectors), np.float64)
        found[name] = found_again(likeness, same, allowed, PRECISION)[returns]
    return found


def requirements(found: Mapping[str, Mapping[str, NDArray[np.bool_]]]) -> tuple[Check, ...]:
    """Requirement that ours recognises more returns than RIVAL; empty if ours is not measured.

    Compared in pairs, the recall of both on each stretch of a drive. found: results of `measured`
    by drive.
    """
    recall: dict[str, dict[tuple[str, int], float | None]] = {OURS: {}, RIVAL: {}}
    for drive, by_name in found.items():
        for name in recall.keys() & by_name.keys():
            for k, stretch in enumerate(np.array_split(by_name[name], STRETCHES)):
                # half a return added on both sides: no recall is 0, so ratios are finite
                recall[name][drive, k] = float((stretch.sum() + 0.5) / (len(stretch) + 1))
    if not recall[OURS]:
        return ()
    what = f"recall of {RIVAL} over ours, {len(found)} drives"
    return tuple(ratio_check(what, compare(recall[RIVAL], recall[OURS]), 1.0))


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add_arguments(parser, "descriptor")


def run(options: argparse.Namespace) -> int:
    """Measure, print and save the table; return 1 if a requirement is not met."""
    rows: list[tuple[Any, ...]] = []
    found: dict[str, dict[str, NDArray[np.bool_]]] = {}
    notes = [f"the best candidate, accepted where {100 * PRECISION:g} % of all accepted are right"]
    training = TRAINING(options.out)
    if isinstance(training, str):
        raise EvaluationError(training)
    files = pictures(training, 0)
    some = files[:: max(1, len(files) // TRAINING_PICTURES)]
    vlad = SiftVlad([read_picture(file) for file in some])
    makers: dict[str, PlaceDescriptor] = {RIVAL: vlad, "gradients": GradientLayout()}
    ours, missing = contestant(options.ours, "describe")
    if ours is not None:
        makers = {OURS: ours, **makers}
    else:
        notes.append(missing)
    drives = UNSEEN if options.held_out else DEVELOPMENT
    for name, folder in prepared(drives, options.only, options.out, notes):
        again = found[name] = measured(folder, makers)
        recalls = (100 * float(again[label].mean()) for label in makers)
        rows.append((name, len(again[RIVAL]), *recalls))
    made = Table(
        f"52_model_places{'_held_out' if options.held_out else ''}",
        "Places found again",
        f"python -m bench model.places{' --held-out' * options.held_out}",
        ("drive", "returns", *(f"{label} recall %" for label in makers)),
        tuple(rows),
        requirements(found),
        tuple(notes),
    )
    return publish(made, options.out)
