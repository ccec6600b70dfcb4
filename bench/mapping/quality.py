"""Map accuracy, completeness and seams on a recording, of calm-edge and of the baselines.

Seams: distances between the positions of a point in two sub-maps. Ghosts: points above the road
where nothing is. Calm-edge is also measured without each part of section VI. All rows use the same
depth; `--warp` adds a smooth error to it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np

from bench.baselines.chain import ALIGNMENTS, chain
from bench.mapping.build import build
from bench.mapping.rows import (
    Cameras,
    Quality,
    baseline,
    on_true_poses,
    ours,
)
from bench.recorded import read
from bench.tables import OUT, Check, Table, publish
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.estimate import from_recording, from_updates
from calm_edge.evaluation.results import common_origin
from calm_edge.evaluation.truth import Truth, read_truth
from calm_edge.types import Int

BASELINES = ("sim3", "sl4")
COLUMNS = (
    "map",
    "accuracy m",
    "completeness m",
    "chamfer m",
    "seam median m",
    "seam p95 m",
    "ghosts",
    "ghosts %",
)


def measure(
    path: Path, truth: Truth, assignments: Sequence[str], align: str, warp: float
) -> list[Quality]:
    """Compute all rows for a recording.

    assignments: SECTION.KEY=VALUE over its configuration. align: `se3` or `sim3`, of map to truth.
    warp: amplitude of a smooth relative error added to the depth, 0 for none. Raises CalmEdgeError
    where the recording cannot be mapped or compared.
    """
    recorded = read(path, assignments)
    config, drive = recorded.config, recorded.drive
    if not drive.updates:
        raise EvaluationError(f"{path}: no window could be solved; nothing to map")
    first_frame = from_recording(path).first_frame
    spacing = config.scale.spacing
    scale = align == "sim3" or not config.scale.spacing_m

    def on_truth(t_ns: Int) -> Int:
        return common_origin(t_ns, truth.t_ns, first_frame)

    with tempfile.TemporaryDirectory(prefix="mapping-") as scratch:
        folder = Path(scratch)
        built = build(recorded, folder, warp)
        whole = from_updates(str(path), drive.updates)
        cameras = Cameras(on_truth(whole.t_ns), whole.T_w_c[:, :3, 3], scale)
        rows = list(ours(built, config.mapping, built.submaps, cameras, truth, folder / "ours"))
        for kind in BASELINES:
            result = chain(ALIGNMENTS[kind], built.submaps, built.overlaps)
            stamps = on_truth(result.t_ns)
            rows.append(baseline(built, result, config.mapping, spacing, stamps, truth))
        if config.scale.spacing_m:
            central = np.array([s.t_ns[s.n_primary // 2] for s in built.submaps])
            placed = on_true_poses(built.submaps, on_truth(central), truth)
            cameras = Cameras(truth.t_ns, truth.T_w_c[:, :3, 3], False)
            there = ours(built, config.mapping, placed, cameras, truth, folder / "true")
            rows += [replace(row, name=f"{row.name}, true poses") for row in there]
        for text in built.skipped:
            print(text, file=sys.stderr)
    return rows


def against(rows: Sequence[Quality]) -> tuple[Check, ...]:
    """Require accuracy, completeness and Chamfer distance better than those of each baseline."""
    found = {row.name: row for row in rows}
    checks = []
    for alignment in (ALIGNMENTS[kind] for kind in BASELINES):
        full, other = found["full"].error, found[alignment.name].error
        ratios: list[float] | str = found[alignment.name].failed or "no map"
        if full and other:
            pairs = zip(astuple(full), astuple(other), strict=True)
            ratios = [round(a / b, 3) for a, b in pairs]
        kept = full is not None and (isinstance(ratios, str) or max(ratios) < 1)
        what = f"accuracy, completeness, chamfer over those of {alignment.name}"
        checks.append(Check(what, "< 1 each", ratios, kept))
    return tuple(checks)


def table(rows: Sequence[Quality], name: str, command: str) -> Table:
    """Make the table of the rows."""
    cells = [
        (
            row.name if not row.failed else f"{row.name}: {row.failed}",
            *(
                (row.error.accuracy_m, row.error.completeness_m, row.error.chamfer_m)
                if row.error
                else (None,) * 3
            ),
            *((row.seams.median_after, row.seams.p95_after) if row.seams else (None,) * 2),
            *((row.ghosts.count, 100 * row.ghosts.share) if row.ghosts else (None,) * 2),
        )
        for row in rows
    ]
    notes = (
        "accuracy: map to truth, completeness: truth to map, chamfer: their mean (paper VII-C)",
        "all rows use one depth; each map is aligned with the truth by its own cameras",
        "seam: distance between the positions that two sub-maps give an anchor they share",
        "ghosts: points above the road along the path, farther than 0.5 m from every true one; "
        "their share of the points there. Cars that drive leave them: compare with a map of "
        "--set backbone.reject_moving=false",
        "true poses: each sub-map is placed by the true pose of its central keyframe",
    )
    return Table(
        f"mapping_{name}",
        f"Map quality on {name}",
        command,
        COLUMNS,
        tuple(cells),
        against(rows),
        notes,
    )


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("recording", type=Path)
    parser.add_argument("--truth", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--align", choices=("sim3", "se3"), default="sim3")
    parser.add_argument(
        "--warp",
        type=float,
        default=0.0,
        metavar="SHARE",
        help="distort each sub-map's depth smoothly by up to this share of it",
    )
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Map a recording, compare the map with the ground-truth cloud, print and save the table."""
    truth = read_truth(options.truth)
    rows = measure(options.recording, truth, options.set, options.align, options.warp)
    name = options.truth.resolve().name + (f"_warp{options.warp:g}" if options.warp else "")
    publish(table(rows, name, options.command), options.out)
    return 0
