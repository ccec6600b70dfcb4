"""The tests that look at signals pass however `make test` was started."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# it looks at the handler of SIGINT
CASE = "tests/device/test_oak.py::test_a_missing_device_gives_one_line_and_no_telemetry"


def in_background_by_nohup() -> None:
    """As a shell without job control starts `nohup COMMAND &`."""
    for ignored in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
        signal.signal(ignored, signal.SIG_IGN)


def test_signals_that_are_ignored_from_the_start_change_nothing() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", CASE],
        cwd=ROOT, preexec_fn=in_background_by_nohup, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
