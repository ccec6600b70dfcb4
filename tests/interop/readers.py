"""Open a recording with MCAP readers of other makers: `make readers`.

Without an argument a small recording is made; with one, the recording in that folder is read.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from mcap.reader import make_reader

from calm_edge.recording.scan import scan
from calm_edge.recording.segment import segment_files
from tests.faults.independent_reader import build_rust, independent_counts
from tests.recording import samples

HERE = Path(__file__).parent
BUILD = Path(__file__).parents[2] / "build"


def expected(folder: Path) -> Counter[str]:
    """Number of messages of each topic, by our own index."""
    counts: Counter[str] = Counter()
    for file in segment_files(folder):
        index = scan(file)
        for i, rows in index.rows.items():
            counts[index.channels[i].topic] += len(rows)
    return counts


def verdict(counts: Counter[str], wanted: Counter[str]) -> str:
    """Whether a reader has found the messages."""
    if counts != wanted:
        return f"FAILED: has {dict(counts)}, expected {dict(wanted)}"
    return f"ok, {counts.total()} messages of {len(counts)} topics"


def summed(lines: Iterable[str]) -> Counter[str]:
    """Counts of lines `FILE TOPIC COUNT`."""
    counts: Counter[str] = Counter()
    for line in lines:
        _, topic, n = line.rsplit(" ", 2)
        counts[topic] += int(n)
    return counts


def python(folder: Path) -> str:
    """Result of the Python reader, with its check of every checksum."""
    counts: Counter[str] = Counter()
    for file in segment_files(folder):
        with file.open("rb") as opened:
            for _, channel, _ in make_reader(opened, validate_crcs=True).iter_messages():
                counts[channel.topic] += 1
    return verdict(counts, expected(folder))


def rust(folder: Path) -> str:
    """Result of the Rust reader."""
    if not build_rust(BUILD):
        return "skipped: cargo is not installed or cannot build tests/interop/mcap_count"
    name, counts = independent_counts([folder], BUILD)
    return verdict(counts, expected(folder)) if name == "Rust mcap" else f"FAILED: {name} was used"


def javascript(folder: Path) -> str:
    """Result of the JavaScript reader, by the files' index."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        return "skipped: node and npm are not installed"
    there = BUILD / "mcap_node"
    there.mkdir(parents=True, exist_ok=True)
    for source in sorted((HERE / "mcap_node").iterdir()):
        shutil.copy(source, there)
    if not (there / "node_modules" / "@mcap" / "core").is_dir():
        quiet = ["--silent", "--no-audit", "--no-fund", "--ignore-scripts"]
        if subprocess.run(["npm", "ci", *quiet], cwd=there).returncode:
            return "skipped: npm cannot install @mcap/core"
    files = [str(file.resolve()) for file in segment_files(folder)]
    command = ["node", str(there / "main.js"), *files]
    run = subprocess.run(command, capture_output=True, text=True)
    if run.returncode:
        return f"FAILED: {run.stderr.strip()}"
    return verdict(summed(run.stdout.splitlines()), expected(folder))


def rerun(folder: Path) -> str:
    """Result of `rerun mcap check`, which also requires log times in order."""
    program = shutil.which("rerun")
    if program is None:
        return "skipped: rerun is not installed (pip install rerun-sdk)"
    for file in segment_files(folder):
        command = [program, "mcap", "check", str(file)]
        run = subprocess.run(command, capture_output=True, text=True)
        if run.returncode:
            return f"FAILED: {file.name}: {(run.stdout + run.stderr).strip()}"
    return "ok"


READERS = {"Python mcap": python, "Rust mcap": rust, "JavaScript": javascript, "rerun": rerun}


def main(arguments: list[str]) -> int:
    """Print a line for each reader; 1 if one of them failed."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(arguments[0]) if arguments else samples.small_recording(Path(scratch) / "rec")
        failed = False
        for name, read in READERS.items():
            result = read(folder)
            failed |= result.startswith("FAILED")
            print(f"{name:12} {result}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
