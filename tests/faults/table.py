"""Print the fault table: `python -m tests.faults.table [WORD ...]`, or `make faults`.

Each row injects one fault into the daemon and compares the result with what must happen. WORD
selects the rows whose names contain it. Exit code 1 if a row fails. Power cuts, failing block
devices (dm-flakey) and unplugged cameras are tested by `make vm-test`.
"""

from __future__ import annotations

import logging
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tests.faults import (
    gps_rows,
    isolation_rows,
    output_rows,
    process_rows,
    storage_rows,
    time_rows,
)
from tests.faults.endurance_rows import endurance
from tests.faults.independent_reader import build_rust
from tests.faults.malformed_rows import malformed
from tests.faults.row import Row
from tests.replay.small_drive import write_drive

PROJECT = Path(__file__).parents[2]
SHORT, LONG = 100, 250
MALFORMED = 10_000

Fault = Callable[[Path, int, Path], Row]


def table(short: Path, long: Path) -> dict[str, Callable[[Path], Row]]:
    """Return name -> function that runs the row in a folder. short, long: drives to record."""

    def on_short(fault: Fault) -> Callable[[Path], Row]:
        return lambda folder: fault(short, SHORT, folder)

    def stamps(kind: str) -> Callable[[Path], Row]:
        return lambda folder: time_rows.wrong_stamps(short, SHORT, folder, kind)

    def damaged(kind: str) -> Callable[[Path], Row]:
        return lambda _: malformed(kind, MALFORMED)

    return {
        "kill": lambda folder: process_rows.kill_9(long, folder, times=20, longest_s=12.0),
        "sigterm": lambda folder: process_rows.terminated(long, folder, after_s=6.0),
        "hang": lambda folder: process_rows.hung(long, folder),
        "disk-full": on_short(storage_rows.full_disk),
        "disk-error": on_short(storage_rows.failing_disk),
        "disk-read-only": on_short(storage_rows.read_only_disk),
        "disk-blocks": on_short(isolation_rows.blocking_disk),
        "disk-blocks-for-ever": on_short(isolation_rows.blocking_disk_full_queue),
        "estimator-suspended": on_short(isolation_rows.suspended_estimator),
        "estimator-slow": lambda folder: isolation_rows.slow_from_the_start(long, LONG, folder),
        "tracker-suspended": on_short(isolation_rows.suspended_tracker),
        "serial-stalled": on_short(isolation_rows.stalled_serial),
        **{
            f"gps-{kind}": on_short(partial(gps_rows.faulty_gps, kind=kind))
            for kind in gps_rows.KINDS
        },
        "gps-missing": on_short(gps_rows.no_receiver),
        "live-page-suspended": on_short(isolation_rows.suspended_live_page),
        "outputs-fail": on_short(output_rows.bad_outputs),
        "stamps-future": stamps("from the future"),
        "stamps-backwards": stamps("backwards"),
        "stamps-none": stamps("without a clock"),
        "wall-clock": on_short(time_rows.wall_clock),
        "throttling": lambda folder: time_rows.throttling(long, LONG, folder),
        **{f"malformed-{kind}": damaged(kind) for kind in ("recordings", "configs", "models")},
        "malformed-serial": damaged("serial"),
        "endurance": lambda folder: endurance(4.0, 20.0, folder),
    }


def text_of(row: Row) -> str:
    """Format a row of the table."""
    verdict = "skipped" if row.skipped else "kept" if row.kept else "BROKEN"
    return f"| {row.fault} | {row.figure} | {row.promise} | {verdict} |"


def main(words: list[str]) -> int:
    """Run the selected rows and print each as it ends; return 1 if one fails."""
    # log messages are expected during faults
    logging.disable(logging.CRITICAL)
    build_rust(PROJECT / "build" / "interop")
    broken = 0
    with tempfile.TemporaryDirectory(prefix="calm-edge-faults-") as work:
        place = Path(work)
        short = write_drive(place / "short", SHORT)
        long = write_drive(place / "long", LONG)
        print("| fault | result | required | |\n|---|---|---|---|", flush=True)
        for name, fault in table(short, long).items():
            if words and not any(word in name for word in words):
                continue
            folder = place / name
            folder.mkdir()
            started = time.monotonic()
            try:
                row = fault(folder)
            except Exception as error:
                # a row that raises must not prevent the others
                traceback.print_exc()
                row = Row(name, f"{type(error).__name__}: {error}", "the row runs", False)
            broken += not (row.kept or row.skipped)
            print(text_of(row), flush=True)
            print(f"{name}: {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
