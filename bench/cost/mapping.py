"""Processor time of anchors and mapping by stage, on one core, without computing the depth."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest import mock

import cv2

from bench.recorded import Dense, dense, read
from bench.tables import OUT, Check, Table, publish
from calm_edge.config import MappingConfig
from calm_edge.mapping import mapper as mapper_module
from calm_edge.mapping import skeleton as skeleton_module
from calm_edge.mapping.deform import Deformation
from calm_edge.mapping.fuse import Fusion
from calm_edge.mapping.mapper import Mapper
from calm_edge.mapping.spool import Spool
from calm_edge.mapping.voxel_filter import VoxelFilter
from calm_edge.types import CalmEdgeError

TARGET_S, PAPER_S = 0.30, 0.95
# title, owner and attribute of each function timed
STAGES: tuple[tuple[str, Any, str], ...] = (
    ("spool depth and colour", Spool, "write"),
    ("load depth", skeleton_module.Skeleton, "views"),
    ("copy forward", skeleton_module, "copy_forward"),
    ("extract", skeleton_module, "extract"),
    ("spread back", skeleton_module, "spread_back"),
    ("fuse", Fusion, "add"),
    ("suppress", Fusion, "active"),
    ("points of the cloud", mapper_module, "submap_points"),
    ("fit the thin plate", mapper_module, "fit_deformation"),
    ("apply it", Deformation, "apply"),
    ("one point a voxel", VoxelFilter, "admit"),
)


@dataclass(slots=True)
class Cost:
    """Totals over all sub-maps.

    seconds: processor time by stage. points: number of points of the clouds before the voxel
    filter. controls: number of control points of the thin-plate splines that align sub-maps.
    """

    submaps: int = 0
    seconds: dict[str, float] = field(default_factory=lambda: defaultdict(float))
    points: int = 0
    controls: int = 0


@contextmanager
def timed_stages(cost: Cost) -> Iterator[None]:
    """Context in which the processor time of each stage is added to `cost`.

    The time of a nested stage is added to the inner stage only.
    """
    running: list[float] = []

    def timed(stage: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **named: Any) -> Any:
            start = time.process_time()
            running.append(0.0)
            try:
                return work(*arguments, **named)
            finally:
                took = time.process_time() - start
                cost.seconds[stage] += took - running.pop()
                if running:
                    running[-1] += took

        return run

    patches = [
        mock.patch.object(owner, name, timed(stage, getattr(owner, name)))
        for stage, owner, name in STAGES
    ]
    for patch in patches:
        patch.start()
    try:
        yield
    finally:
        for patch in patches:
            patch.stop()


def measure(pieces: Sequence[Dense], config: MappingConfig, spacing: float, folder: Path) -> Cost:
    """Map the sub-maps and measure the time of each stage.

    pieces: sub-maps with depth. spacing: world units per map unit. folder: for the mapper's files.
    """
    cost = Cost(len(pieces))
    start = time.process_time()
    with timed_stages(cost):
        mapper = Mapper(config, spacing, folder)
        for piece in pieces:
            mapper.add(*piece)
        for _ in mapper.finish():
            pass
    total = time.process_time() - start
    cost.seconds["everything else"] = total - sum(cost.seconds.values())
    cost.points = sum(len(mapper.points(submap.id)[0]) for submap, *_ in pieces)
    cost.controls = sum(len(d.plate.controls) for d in mapper.deformations().values())
    return cost


def table(cost: Cost, command: str) -> Table:
    """Table with one row for each stage, milliseconds per sub-map."""
    n = max(1, cost.submaps)
    rows = [(stage, 1000 * seconds / n) for stage, seconds in cost.seconds.items()]
    total = sum(cost.seconds.values()) / n
    rows.append(("all", 1000 * total))
    check = Check(
        "anchors + mapping, seconds a sub-map",
        f"<= {TARGET_S} (paper {PAPER_S})",
        round(total, 3),
        total <= TARGET_S,
    )
    notes = (
        f"{cost.submaps} sub-maps, {cost.points / n:,.0f} points and {cost.controls / n:.0f} "
        "control points each; processor time of one core, depth not counted",
    )
    title = "Anchors and mapping, milliseconds a sub-map"
    return Table("bench_mapping", title, command, ("stage", "ms"), tuple(rows), (check,), notes)


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("recording", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Map a recording, print and save the table; return 1 if it takes longer than required."""
    cv2.setNumThreads(1)
    recorded = read(options.recording, options.set)
    pieces: list[Dense] = []
    for found in dense(recorded):
        if isinstance(found, str):
            print(found, file=sys.stderr)
        else:
            pieces.append(found)
    if not pieces:
        raise CalmEdgeError(f"{options.recording}: no window has depth; nothing to measure")
    config = recorded.config
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        cost = measure(pieces, config.mapping, config.scale.spacing, Path(folder))
    return publish(table(cost, options.command), options.out)
