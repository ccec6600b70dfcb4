"""`calm-edge doctor`: what this machine lacks, and what that costs."""

from __future__ import annotations

import argparse
import importlib.util
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from calm_edge.commands.exit_codes import ERROR, OK

NEEDED = {
    "cv2": "no images can be decoded",
    "numpy": "nothing works",
    "scipy": "no reconstruction",
    "gtsam": "no trajectory",
    "mcap": "no recording",
    "foxglove_schemas_protobuf": "no recording",
}
OPTIONAL = {
    "systemd": "no watchdog and no readiness under systemd "
    "(apt-get install gcc pkg-config libsystemd-dev python3-dev && make setup)",
    "serial": "no pose on a serial port",
    "depthai": "no OAK cameras",
    "matplotlib": "no drawings in reports",
    "onnxruntime": "no models of models/ (bundle needs none)",
}
FREE_GB = 2.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Its arguments."""
    parser.add_argument(
        "--out", type=Path, default=Path(), help="where recordings go, to check for space"
    )


def findings(out: Path) -> Iterator[tuple[bool, str]]:
    """(is it fatal, one line) for each thing that is missing."""
    for table, fatal in ((NEEDED, True), (OPTIONAL, False)):
        for module, cost in table.items():
            if importlib.util.find_spec(module) is None:
                yield fatal, f"{module}: not installed (make setup): {cost}"
    cores = len(os.sched_getaffinity(0))
    if cores < 2:
        yield False, f"{cores} core: the estimator will lag behind; map catches up"
    if not out.is_dir():
        yield False, f"{out}: no such folder yet; the disk it would lie on was not checked"
    else:
        free_gb = shutil.disk_usage(out).free / 1e9
        if free_gb < FREE_GB:
            yield True, f"{out}: only {free_gb:.1f} GB free; two cameras fill 10 GB an hour"
        if not os.access(out, os.W_OK):
            yield True, f"{out}: not writable"
    if not list(Path("/dev").glob("video*")):
        yield False, "no /dev/video*: only replays (--sequence, --replay) can be recorded"


def run(arguments: argparse.Namespace) -> int:
    """Prints a line a finding."""
    found = list(findings(arguments.out))
    for fatal, line in found:
        print(f"{'missing' if fatal else 'note':8} {line}")
    if not found:
        print("nothing is missing")
    return ERROR if any(fatal for fatal, _ in found) else OK
