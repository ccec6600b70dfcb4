"""Message counts by an MCAP reader that shares no code with calm-edge."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections import Counter
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

CRATE = Path(__file__).parents[1] / "interop" / "mcap_count"


def independent_counts(folders: list[Path], build: Path) -> tuple[str, Counter[str]]:
    """Return (name of the reader, topic -> number of messages) over the segments of folders.

    Uses the Rust crate if it is built (by `make faults`, if cargo is installed), else the Python
    stream reader of mcap.
    """
    files = sorted(p for folder in folders for p in folder.glob("*.mcap*"))
    program = build / "mcap_count" / "release" / "mcap_count"
    if not program.exists():
        return "Python mcap", _python_counts(files)
    run = subprocess.run([program, *files], capture_output=True, text=True, check=True)
    counts: Counter[str] = Counter()
    for line in run.stdout.splitlines():
        _, topic, n = line.rsplit(" ", 2)
        counts[topic] += int(n)
    return "Rust mcap", counts


def build_rust(build: Path) -> bool:
    """Compile the Rust reader; False without cargo or if the build fails."""
    cargo = shutil.which("cargo")
    if cargo is None:
        return False
    command = [cargo, "build", "--release", "--locked", "--quiet"]
    environment = {**os.environ, "CARGO_TARGET_DIR": str(build / "mcap_count")}
    return subprocess.run(command, cwd=CRATE, env=environment).returncode == 0


def _python_counts(files: list[Path]) -> Counter[str]:
    counts: Counter[str] = Counter()
    for path in files:
        topics: dict[int, str] = {}
        with path.open("rb") as file:
            try:
                for record in StreamReader(file).records:
                    if isinstance(record, Channel):
                        topics[record.id] = record.topic
                    elif isinstance(record, Message):
                        counts[topics[record.channel_id]] += 1
            except (McapError, EOFError):
                continue
    return counts
