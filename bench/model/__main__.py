"""`python -m bench.model`: what the learned model has to beat, and whether it does.

Rendered drives give exact truth: of every query point that the other picture shows, how many are
found within one and three pixels. The shipped model takes part where it is there, another one as
`--ours MODULE:FACTORY`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from bench.model import match_table
from bench.model.matchers import BASELINES
from bench.model.ours import contestant
from bench.tables import OUT, publish
from calm_edge.types import CalmEdgeError


def main(argv: list[str] | None = None) -> int:
    """Measure, print and keep the table; 1 when a promise is broken."""
    parser = argparse.ArgumentParser(prog="bench.model", description=__doc__)
    parser.add_argument("--ours", metavar="MODULE:FACTORY", help="the learned matcher")
    parser.add_argument("--matcher", action="append", choices=list(BASELINES))
    parser.add_argument("--only", action="append", metavar="DRIVE")
    parser.add_argument("--held-out", action="store_true", help="tracks nothing is tuned on")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(argv)
    try:
        matchers = {name: BASELINES[name]() for name in options.matcher or BASELINES}
        ours, missing = contestant(options.ours, "match")
        if ours is not None:
            matchers = {match_table.OURS: ours, **matchers}
        table = match_table.run(matchers, options.held_out, options.only, options.out, missing)
    except CalmEdgeError as error:
        print(error, file=sys.stderr)
        return 1
    publish(table, options.out)
    return 0 if all(check.passed for check in table.checks) else 1


if __name__ == "__main__":
    sys.exit(main())
