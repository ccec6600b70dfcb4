"""Time until the command line answers: `--help`, `--version` and the help of each command.

Each is run as a process of its own, several times, in turn; the median is that of the runs.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from statistics import median

from calm_edge.cli import COMMANDS

# the interpreter alone, for comparison
EMPTY = "python -c pass"
TOO_SLOW_S = 0.5


def configure(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--runs", type=int, default=7, help="of each command")


def run(options: argparse.Namespace) -> int:
    """Print the table; 1 if `--help` takes longer than TOO_SLOW_S."""
    calm_edge = [sys.executable, "-m", "calm_edge.cli"]
    commands = {EMPTY: [sys.executable, "-c", "pass"]}
    for words in (["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)):
        commands["calm-edge " + " ".join(words)] = [*calm_edge, *words]
    seconds: dict[str, list[float]] = {name: [] for name in commands}
    for _ in range(options.runs):
        for name, command in commands.items():
            begun = time.perf_counter()
            subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
            seconds[name].append(time.perf_counter() - begun)
    for name, taken in seconds.items():
        print(f"{1e3 * median(taken):6.0f} ms  {name}")
    slow = median(seconds["calm-edge --help"])
    return int(slow > TOO_SLOW_S)
