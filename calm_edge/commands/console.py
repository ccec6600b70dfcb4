"""Exit codes of the commands and their messages to the user.

Results go to stdout, everything else to stderr.
"""

from __future__ import annotations

import sys

# LOSS: the output was written, but data or poses are lost. argparse uses 2, for wrong usage
OK, ERROR, LOSS = 0, 1, 3


def say(text: str) -> None:
    """Print a message line to stderr."""
    print(f"calm-edge: {text}", file=sys.stderr, flush=True)
