"""The tests that look at signals pass however `make test` was started."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
# it looks at the handler of SIGINT
CASE = "tests/device/test_oak.py::test_a_missing_device_gives_one_line_and_no_telemetry"


def in_background() -> None:
    """As a shell without job control starts a command that ends in `&`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGQUIT, signal.SIG_IGN)


def by_nohup() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)


def by_both() -> None:
    in_background()
    by_nohup()


@pytest.mark.parametrize("start", [in_background, by_nohup, by_both])
def test_signals_that_are_ignored_from_the_start_change_nothing(start: Callable[[], None]) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", CASE],
        cwd=ROOT, preexec_fn=start, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        check=False, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
