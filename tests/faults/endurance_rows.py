"""Hours of simulated time: constant memory, every lost frame counted, old drives removed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.faults.row import Row

PROJECT = Path(__file__).parents[2]
# of capture and tracker; the estimator keeps the poses of all sub-maps and is reported only
MOST_GROWN_MIB = 16.0
# within minutes, most growth is due to libraries and the first windows
MOST_GROWN_AT_FIRST_MIB = 64.0
WARM_HOURS = 1.0


def endurance(hours: float, speed: float, folder: Path) -> Row:
    """Run `endurance_child` in a process of its own, as memory is measured."""
    command = [sys.executable, "-m", "tests.faults.endurance_child"]
    command += [str(hours), str(speed), str(folder)]
    run = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True)
    fault = f"{hours:g} h of simulated time at {speed:g}x"
    most_mib = MOST_GROWN_MIB if hours >= WARM_HOURS else MOST_GROWN_AT_FIRST_MIB
    promise = f"memory flat (< {most_mib:g} MiB), zero unexplained drops"
    if run.returncode:
        return Row(fault, " | ".join(run.stderr.strip().splitlines()[-3:]), promise, False)
    found = json.loads(run.stdout.splitlines()[-1])
    grown = found["growth_mib"]
    disk = (
        f"{found['removed_segments']} segments removed for room"
        if found["own_disk"]
        else "no disk of its own could be mounted: nothing removed"
    )
    return Row(
        fault,
        f"{2 * found['frames']:,} frames, {found['unexplained']} unexplained, "
        f"{found['unrecorded']} counted as not recorded, {found['untracked']:,} not tracked, "
        f"{found['submaps']:,} of {found['windows']:,} sub-maps; MiB grown: "
        + ", ".join(f"{name} {mib:+.1f}" for name, mib in grown.items())
        + f"; {disk}",
        promise,
        found["unexplained"] == 0
        and max(grown["capture"], grown["tracker"]) < most_mib
        and found["windows"] > 0
        and found["kept_there"]
        and found["old_gone"] == found["own_disk"],
    )
