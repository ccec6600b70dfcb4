"""Error text of child processes."""

from __future__ import annotations

import subprocess


def last_line(done: subprocess.CompletedProcess[str]) -> str:
    """Last line of stderr, or of stdout if stderr is empty."""
    lines = (done.stderr or done.stdout).strip().splitlines()
    return lines[-1] if lines else "no output"
