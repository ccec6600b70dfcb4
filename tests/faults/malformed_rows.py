"""Damaged input gives error lines: no traceback, no hang, bounded memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.faults.row import Row

PROJECT = Path(__file__).parents[2]
# a chunk may decompress to 256 MiB; reading small files must stay well below
MOST_GROWN_MIB = 400.0


def malformed(kind: str, count: int, seed: int = 1) -> Row:
    """Feed `count` damaged inputs of a kind of `malformed_child`."""
    command = [sys.executable, "-m", "tests.faults.malformed_child", kind, str(count), str(seed)]
    run = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True)
    fault = f"malformed {kind}, {count:,}"
    promise = f"one line each, no hang, memory grows < {MOST_GROWN_MIB:g} MiB"
    if run.returncode:
        return Row(fault, " | ".join(run.stderr.strip().splitlines()[-3:]), promise, False)
    found = json.loads(run.stdout)
    return Row(
        fault,
        f"{found['reported']:,} reported, slowest {found['slowest_ms']:.0f} ms of CPU time, memory "
        f"+{found['grown_mib']:.0f} MiB",
        promise,
        found["reported"] > 0 and found["grown_mib"] < MOST_GROWN_MIB,
    )
