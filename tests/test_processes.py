"""Children end with their parent, and only with it; SIGTERM interrupts as Ctrl-C does."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from calm_edge.processes import GROUP_SIGNALS, interrupted_by_sigterm

CHILD = """
import multiprocessing, os, sys, time
from calm_edge.processes import follow_parent

def work(connection):
    follow_parent()
    connection.send(os.getpid())
    time.sleep(60)

if __name__ == "__main__":
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    context.Process(target=work, args=(theirs,), daemon=True).start()
    print(ours.recv(), flush=True)
    time.sleep(60)
"""


@pytest.fixture
def parent(tmp_path: Path) -> subprocess.Popen[str]:
    """A process that has a child; both sleep."""
    script = tmp_path / "parent.py"
    script.write_text(CHILD)
    return subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])},
    )


def ended(pid: int) -> bool:
    """Whether a process has ended, also if nobody has waited for it."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state in "ZX"


def within(limit_s: float, holds: Callable[[], bool]) -> bool:
    end_s = time.monotonic() + limit_s
    while not holds() and time.monotonic() < end_s:
        time.sleep(0.02)
    return holds()


def test_a_child_outlives_signals_to_the_group_and_ends_with_its_parent(
    parent: subprocess.Popen[str],
) -> None:
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    for number in GROUP_SIGNALS:
        os.kill(child, number)
    assert not within(0.3, lambda: ended(child))
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert within(5.0, lambda: ended(child))


def test_sigterm_interrupts_and_its_handler_is_restored() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), interrupted_by_sigterm():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    assert signal.getsignal(signal.SIGTERM) == before
