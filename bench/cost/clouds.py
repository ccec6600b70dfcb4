"""Peak memory and time of exported clouds: the points of a map, repeated side by side.

A cloud of so many points is written beside the map's trajectory, and exported by a process whose
largest resident memory the kernel reports.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.drives import ROOT
from bench.tables import OUT, Check, Table, publish
from calm_edge.commands.exit_codes import LOSS, OK
from calm_edge.interchange.export.cloud import TILE
from calm_edge.interchange.export.drive import MAP, SUMMARY, TUM
from calm_edge.mapping.cloud_file import CloudWriter, count_points, read_tiles
from calm_edge.types import CalmEdgeError, MapTile

COLUMNS = ("format", "points", "peak MiB", "s", "MB written")
FORMATS = ("ply", "laz")
# of the largest cloud's memory over that of the smallest one
LARGEST_RATIO = 1.25


@dataclass(frozen=True, slots=True)
class Exported:
    """One export. peak_mib: largest resident memory of its process. written_mb: of its file."""

    format: str
    points: int
    peak_mib: float
    wall_s: float
    written_mb: float


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("map", type=Path, help="a folder made by calm-edge map")
    parser.add_argument("--points", type=float, nargs="+", default=[2e6, 50e6], metavar="N")
    parser.add_argument("--to", nargs="+", choices=FORMATS, default=list(FORMATS))
    parser.add_argument("--scratch", type=Path, metavar="DIR", help="for the clouds; 2 GB")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Export all clouds; 1 if memory grows with the number of points."""
    found: list[Exported] = []
    for count in sorted(map(int, options.points)):
        with tempfile.TemporaryDirectory(prefix="bench-", dir=options.scratch) as scratch:
            folder = repeated(options.map, Path(scratch) / "map", count)
            for name in options.to:
                found.append(exported(folder, name, Path(scratch) / name))
                print(f"{name}: {found[-1]}", file=sys.stderr)
                shutil.rmtree(Path(scratch) / name)
    return publish(table(found, options.command), options.out)


def repeated(source: Path, folder: Path, count: int) -> Path:
    """Map folder with a cloud of `count` points: those of `source`, copies side by side."""
    folder.mkdir()
    for name in (SUMMARY, TUM):
        shutil.copyfile(source / name, folder / name)
    if not count_points(source / MAP):
        raise CalmEdgeError(f"{source / MAP}: holds no point; give a map with a cloud")
    with CloudWriter(folder / MAP) as file:
        for tile in _copies(source / MAP):
            left = count - file.count
            file.write(MapTile(tile.points_w[:left], tile.color[:left]))
            if file.count == count:
                return folder
    raise AssertionError("copies have no end")


def _copies(file: Path) -> Iterator[MapTile]:
    """Tiles of a cloud without end, each copy beside the last one."""
    copy, width = 0, 0.0
    while True:
        for tile in read_tiles(file, TILE):
            width = max(width, float(np.ptp(tile.points_w[:, 0])))
            shift = np.array([copy * width, 0, 0], np.float32)
            yield MapTile(tile.points_w + shift, tile.color)
        copy += 1


def exported(folder: Path, name: str, out: Path) -> Exported:
    """Export a map by a process of its own; raises CalmEdgeError if that fails."""
    started = time.monotonic()
    arguments = ["export", str(folder.resolve()), "--to", name, "--out", str(out.resolve())]
    with tempfile.TemporaryFile() as text:
        child = subprocess.Popen(
            [sys.executable, "-m", "calm_edge.cli", *arguments],
            cwd=ROOT,
            stdout=text,
            stderr=subprocess.STDOUT,
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode not in (OK, LOSS):
            text.seek(0)
            said = text.read().decode(errors="replace").strip().splitlines() or ["no output"]
            raise CalmEdgeError(f"calm-edge export: exit {child.returncode}: {said[-1]}")
    wall_s = time.monotonic() - started
    size = sum(path.stat().st_size for path in out.iterdir())
    return Exported(name, count_points(folder / MAP), used.ru_maxrss / 1024, wall_s, size / 1e6)


def table(found: list[Exported], command: str) -> Table:
    """Table with a row for each export, and a check of each format's memory."""
    rows = [(e.format, e.points, e.peak_mib, e.wall_s, e.written_mb) for e in found]
    checks = []
    for name in dict.fromkeys(e.format for e in found):
        peaks = [e.peak_mib for e in sorted(found, key=lambda e: e.points) if e.format == name]
        ratio = peaks[-1] / peaks[0]
        asked = f"<= {LARGEST_RATIO:g} times that of the smallest cloud"
        checks.append(Check(f"{name}: peak memory", asked, ratio, ratio <= LARGEST_RATIO))
    title = "Memory of exported clouds"
    return Table("bench_clouds", title, command, COLUMNS, tuple(rows), tuple(checks))
