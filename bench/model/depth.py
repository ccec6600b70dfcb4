"""Compare depth of the learned model and of classical methods.

All get the same pictures, cameras and poses.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from bench.model import scenes
from bench.model.depth_makers import MAKERS
from bench.model.depth_scores import (
    DepthScore,
    most_confident,
    relative_error,
    score,
)
from bench.model.ours import OURS, add_arguments, contestant
from bench.model.protocols import DepthMaker
from bench.paired import compare
from bench.tables import Check, Table, publish
from calm_edge.types import Float
from device.frame import Eye

RIVAL, SWEEP = "SGBM", "plane sweep"
PLACES, KEYFRAMES = 3, 5
NEAREST_M, FARTHEST_M = 1.0, 60.0
# Target: largest ratio of our relative depth error to that of semi-global matching.
ASKED = 0.7
COLUMNS = (
    "maker", "coverage %", "abs-rel", "within 5 %", "both: abs-rel", "both: within 5 %",
    "equal share: abs-rel", "equal share: within 5 %", "AUSE", "pictures",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scored:
    """Scores of one method on one picture.

    own: over the pixels where this method has depth. common: over those where all methods have
    depth. equal: over this method's most confident pixels, as many as the method with fewest depths
    has in this picture. coverage: share of pixels with depth by this method.
    """

    maker: str
    drive: str
    place: int
    coverage: float
    own: DepthScore
    common: DepthScore
    equal: DepthScore


def measure_place(
    drive: scenes.Pictures, name: str, place: int, frame: int, makers: Mapping[str, DepthMaker]
) -> list[Scored]:
    """Score all methods on one keyframe: the middle one of KEYFRAMES keyframes.

    frame: first frame searched for keyframes. place: index along the drive.
    """
    frames = drive.keyframes(frame)[:KEYFRAMES]
    sides = [drive.side(eye, k) for eye in (0, 1) for k in frames]
    reference = len(frames) // 2
    cameras, T_w_c = [s.truth.camera for s in sides], np.stack([s.truth.T_w_c for s in sides])
    eyes = np.repeat([0, 1], len(frames))
    true_z = sides[reference].truth.z
    in_range = (true_z > NEAREST_M) & (true_z < FARTHEST_M)
    made = {}
    for label, maker in makers.items():
        z, confidence = maker.depth([s.image for s in sides], cameras, T_w_c, eyes, reference)
        size = true_z.shape[1], true_z.shape[0]
        full = [cv2.resize(m, size, interpolation=cv2.INTER_NEAREST) for m in (z, confidence)]
        made[label] = (_pixels(full[0], in_range), _pixels(full[1], in_range))
    return compared(name, place, _pixels(true_z, in_range), made)


def _pixels(picture: Any, mask: Any) -> Float:
    return np.asarray(np.asarray(picture, np.float32)[mask], np.float64)


def compared(
    name: str, place: int, true_z: Float, made: Mapping[str, tuple[Float, Float]]
) -> list[Scored]:
    """Score depths and confidences (M,) of each method against the true depth (M,).

    Empty if no pixel has depth by all methods.
    """
    known = {label: z > 0 for label, (z, _) in made.items()}
    both = np.logical_and.reduce(list(known.values()))
    least = min(int(k.sum()) for k in known.values())
    if not both.any():
        return []
    out = []
    for label, (z, confidence) in made.items():
        error = relative_error(z, true_z)
        parts = known[label], both, most_confident(known[label], confidence, least)
        own, common, equal = (score(error[p], confidence[p]) for p in parts)
        out.append(Scored(label, name, place, float(known[label].mean()), own, common, equal))
    return out


def table(scored: Sequence[Scored], notes: Sequence[str], held_out: bool) -> Table:
    """Make the table: means over pictures, and in the notes each method paired with RIVAL."""
    rows: list[tuple[Any, ...]] = []
    for label in dict.fromkeys(s.maker for s in scored):
        own = [s for s in scored if s.maker == label]
        parts = [[getattr(s, key) for s in own] for key in ("own", "common", "equal")]
        figures = [v for part in parts for v in (_mean(part, "abs_rel"), _mean(part, "close"))]
        coverage = 100 * float(np.mean([s.coverage for s in own]))
        rows.append((label, coverage, *figures, _mean(parts[2], "ause"), len(own)))
    remarks, checks = list(notes), []
    for label in dict.fromkeys(s.maker for s in scored if s.maker != RIVAL):
        for what, part, key in (
            ("abs-rel where both have depth", "common", "abs_rel"),
            ("abs-rel at equal share", "equal", "abs_rel"),
            ("AUSE at equal share", "equal", "ause"),
        ):
            ours, rival = (_errors(scored, name, part, key) for name in (label, RIVAL))
            if not ours.keys() & rival.keys():
                continue
            ratio = compare(ours, rival)
            shown = f"{ratio.ratio:.3f} ({ratio.low:.3f} to {ratio.high:.3f})"
            remarks.append(f"{label} over {RIVAL}, {what}: {shown}, {ratio.pairs} pictures")
            if label == OURS:
                most = ASKED if key == "abs_rel" else 1.0
                kept = ratio.verdict == "better" and ratio.within(most)
                checks.append(Check(what, f"<= {most:g} of {RIVAL}", shown, kept))
    suffix = " --held-out" if held_out else ""
    return Table(
        f"51_model_depth{'_held_out' if held_out else ''}",
        f"Depth under true cameras and poses{' on held-out drives' if held_out else ''}",
        f"python -m bench model.depth{suffix}",
        COLUMNS, tuple(rows), tuple(checks),
        (
            f"pixels {NEAREST_M:g} to {FARTHEST_M:g} m away; equal share: the most confident "
            "pixels of each, as many as the sparsest gives",
            *remarks,
        ),
    )  # fmt: skip


def _mean(scores: Sequence[DepthScore], key: str) -> float:
    return float(np.mean([getattr(s, key) for s in scores]))


def _errors(
    scored: Sequence[Scored], maker: str, part: str, key: str
) -> dict[tuple[str, int], float | None]:
    return {
        (s.drive, s.place): max(float(getattr(getattr(s, part), key)), 1e-6)
        for s in scored
        if s.maker == maker
    }


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    add_arguments(parser, "depth")


def run(options: argparse.Namespace) -> int:
    """Measure, print and save the table; return 1 if a requirement is not met."""
    scored: list[Scored] = []
    notes: list[str] = []
    makers: dict[str, DepthMaker] = {name: make() for name, make in MAKERS.items()}
    ours, missing = contestant(options.ours, "depth")
    if missing:
        notes.append(missing)
    else:
        makers = {OURS: ours, **makers}
    if options.ours is None:
        # the depth of the shipped model is this same plane sweep: list it only once
        del makers[SWEEP]
    chosen = scenes.UNSEEN if options.held_out else scenes.DEVELOPMENT
    drives = {scene.name: scene.prepare for scene in chosen}
    for name, folder in scenes.prepared(drives, options.only, options.out, notes):
        drive = scenes.Pictures(folder)
        for place, frame in enumerate(scenes.places(drive.sequence.count(Eye.PRIMARY), PLACES)):
            scored += measure_place(drive, name, place, frame, makers)
    return publish(table(scored, notes, options.held_out), options.out)
