"""Error text of child processes."""

from __future__ import annotations

import subprocess


def last_line(done: subprocess.CompletedProcess[str]) -> str:
    """Return the last line of stderr, or of stdout where that is empty."""
    lines = (done.stderr or done.stdout).strip().splitlines()
    return lines[-1] if lines else "no output"
