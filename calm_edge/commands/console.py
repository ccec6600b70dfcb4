"""Messages of the commands to the user.

Results go to stdout, everything else to stderr.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from calm_edge.types import Metre


# What the messages begin with: the program, and the drive if several are worked on at once.
_PREFIX = ContextVar("_PREFIX", default="calm-edge: ")


def say(text: str) -> None:
    """Print a message line to stderr."""
    print(f"{_PREFIX.get()}{text}", file=sys.stderr, flush=True)


@contextmanager
def messages_of(drive: str) -> Iterator[None]:
    """Begin the messages with the name of a drive as well."""
    before = _PREFIX.set(f"{_PREFIX.get()}{drive}: ")
    try:
        yield
    finally:
        _PREFIX.reset(before)


def is_coloured(stream: TextIO) -> bool:
    """Whether to colour what is printed there: a terminal, unless NO_COLOR or TERM=dumb is set."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


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
