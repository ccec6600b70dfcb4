"""Messages of the commands: results to stdout, everything else to stderr."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """Print a line for the user to stderr."""
    print(f"calm-edge: {text}", file=sys.stderr, flush=True)
