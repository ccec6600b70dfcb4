"""Messages of the commands to the user; results go to stdout, everything else to stderr."""

from __future__ import annotations

import sys


def say(text: str) -> None:
    """Print a message line to stderr."""
    print(f"calm-edge: {text}", file=sys.stderr, flush=True)
