"""Bring-up tests of a kit, run one after the other; prints a table to send in.

See hil_tests/README.md for what to plug in.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import sys
from pathlib import Path

from calm_edge.config import load
from calm_edge.types import CalmEdgeError
from hil_tests.kit import Kit
from hil_tests.report import Row, Verdict, judged, text_of, write

TESTS = ("1_enumerate", "2_frame_rate", "3_timestamps", "4_serial", "5_watchdog", "6_soak")
INSTALLED = Path("/etc/calm-edge/calm-edge.toml")


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(prog="make hil", description=__doc__)
    made.add_argument("tests", nargs="*", metavar="N", help="numbers of tests; none: all of them")
    made.add_argument("--config", type=Path, help=f"of the kit; default: {INSTALLED} if it exists")
    made.add_argument("--sequence", type=Path, help="a folder of pictures in place of cameras")
    made.add_argument("--minutes", type=float, default=10.0, help="of the soak (6)")
    made.add_argument("--out", type=Path, default=Path("build/hil"), help="table and recordings")
    return made


def main(argv: list[str] | None = None) -> int:
    """Run the tests named; returns 1 when one failed, 2 for wrong usage."""
    arguments = parser().parse_args(argv)
    logging.basicConfig(stream=sys.stderr, level=logging.ERROR, format="%(message)s")
    chosen = [name for name in TESTS if not arguments.tests or name[0] in arguments.tests]
    unknown = set(arguments.tests) - {name[0] for name in TESTS}
    if unknown:
        print(f"hil: no test {', '.join(sorted(unknown))}; there are 1 to 6", file=sys.stderr)
        return 2
    file = arguments.config or (INSTALLED if INSTALLED.exists() else None)
    try:
        config = load(file)
    except CalmEdgeError as error:
        print(f"hil: {error}", file=sys.stderr)
        return 2
    kit = Kit(config, file, arguments.sequence, arguments.out, arguments.minutes)
    rows: list[Row] = []
    for name in chosen:
        print(f"hil: {name.replace('_', ' ')} ...", file=sys.stderr, flush=True)
        module = importlib.import_module(f"hil_tests.{name}")
        try:
            rows += list(module.rows(kit))
        except (CalmEdgeError, OSError) as error:
            rows.append(judged(module.NAME, "ended early", False, str(error), ""))
    print(text_of(rows), end="")
    print(f"hil: to send in: {write(rows, arguments.out)[0]}", file=sys.stderr)
    return 1 if any(row.verdict is Verdict.FAIL for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
