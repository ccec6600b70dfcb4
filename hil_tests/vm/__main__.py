"""`make vm-test`: tests on an emulated machine. They take minutes; prints a table at the end."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from hil_tests.report import Row, Verdict, judged, skipped, text_of, write
from hil_tests.vm import cameras, loopback, power_cut, service
from hil_tests.vm.kernel import MachineError

TESTS: dict[str, Callable[[Path], Iterator[Row]]] = {
    "cameras": cameras.rows,
    "mjpeg": loopback.rows,
    "power_cut": power_cut.rows,
    "service": service.rows,
}


def main(argv: list[str] | None = None) -> int:
    """Run the tests named; returns 1 when a row failed."""
    parser = argparse.ArgumentParser(prog="make vm-test", description=__doc__)
    parser.add_argument("tests", nargs="*", help=f"{', '.join(TESTS)}; none: all of them")
    parser.add_argument("--out", type=Path, default=Path("build/vm"))
    arguments = parser.parse_args(argv)
    unknown = set(arguments.tests) - TESTS.keys()
    if unknown:
        parser.error(f"no test {', '.join(sorted(unknown))}; there are {', '.join(TESTS)}")
    why = service.missing()
    rows: list[Row] = []
    for name in arguments.tests or TESTS:
        if why:
            rows.append(skipped(name, "all", why))
            continue
        print(f"vm-test: {name} ...", file=sys.stderr, flush=True)
        try:
            for row in TESTS[name]((arguments.out / name).resolve()):
                print(f"{row.verdict} {row.what}: {row.seen}", file=sys.stderr, flush=True)
                rows.append(row)
        except (MachineError, OSError) as error:
            rows.append(judged(name, "ended early", False, str(error), ""))
    print(text_of(rows), end="")
    write(rows, arguments.out)
    return 1 if any(row.verdict is Verdict.FAIL for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
