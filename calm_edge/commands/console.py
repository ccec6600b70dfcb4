"""Messages of the commands to the user.

Results go to stdout, everything else to stderr.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calm_edge.types import Metre


def say(text: str) -> None:
    """Print a message line to stderr."""
    print(f"calm-edge: {text}", file=sys.stderr, flush=True)


def print_metre(metre: Metre, spacing_m: float | None) -> None:
    """Print how well lengths are known, if they are metric."""
    if not spacing_m:
        print(
            "lengths     in camera spacings, not metres: their distance (spacing_m) was not given"
        )
    elif metre.metric:
        print(f"lengths     in metres, sigma {100 * metre.log_sigma:.1f} %")


def say_no_metre(reason: str) -> None:
    """Print that lengths are not metric, and why."""
    say(f"no metre: {reason or 'unknown'}; lengths have an unknown scale")
