"""Open a recording with MCAP readers of other makers: `make readers`."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from calm_edge.recording.scan import scan
from tests.faults.independent_reader import build_rust, independent_counts
from tests.recording import samples

BUILD = Path(__file__).parents[2] / "build"


def rust(file: Path) -> str:
    """Result of the Rust reader: the same number of messages of each topic."""
    if not build_rust(BUILD):
        return "skipped: cargo is not installed or cannot build tests/interop/mcap_count"
    name, counts = independent_counts([file.parent], BUILD)
    index = scan(file)
    expected = Counter({index.channels[i].topic: len(rows) for i, rows in index.rows.items()})
    if name != "Rust mcap" or counts != expected:
        return f"FAILED: {name} has {dict(counts)}, expected {dict(expected)}"
    return f"ok, {counts.total()} messages"


def rerun(file: Path) -> str:
    """Result of `rerun mcap check`, which also requires log times in order."""
    program = shutil.which("rerun")
    if program is None:
        return "skipped: rerun is not installed (pip install rerun-sdk)"
    run = subprocess.run([program, "mcap", "check", str(file)], capture_output=True, text=True)
    text = (run.stdout + run.stderr).strip()
    return "ok" if run.returncode == 0 else f"FAILED: {text}"


def main() -> int:
    """Print a line for each reader; 1 if one of them failed."""
    with tempfile.TemporaryDirectory() as folder:
        file = samples.small_recording(Path(folder) / "rec") / "0000.mcap"
        results = {"Rust mcap": rust(file), "rerun": rerun(file)}
    for name, result in results.items():
        print(f"{name:10} {result}")
    return int(any(result.startswith("FAILED") for result in results.values()))


if __name__ == "__main__":
    sys.exit(main())
