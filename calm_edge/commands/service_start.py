"""Start the installed service, and how to record without it."""

from __future__ import annotations

import os
import shlex
import subprocess
from pathlib import Path

UNIT = "calm-edge.service"
COMMAND = f"systemctl enable {UNIT} && systemctl restart {UNIT}"
BY_HAND = f"sudo sh -c {shlex.quote(COMMAND)}"


def run_as_root(command: str, *, ask: bool) -> bool:
    """Run a shell command, with sudo for other users; whether it succeeded.

    ask: sudo may ask for the password in the terminal.
    """
    words = ["sh", "-c", command]
    if os.geteuid():
        words = ["sudo", *([] if ask else ["-n"]), *words]
    try:
        return subprocess.run(words, check=False).returncode == 0
    except OSError:
        return False


def record_command(path: Path) -> str:
    """The command that records with a configuration file."""
    return f"calm-edge record --config {shlex.quote(str(path))} --out drives/1"
