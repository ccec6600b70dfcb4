"""Test 4 of a kit against a pseudo-terminal in place of an adapter."""

from __future__ import annotations

import importlib
import os
import pty
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from calm_edge.config import Config, merge
from hil_tests.kit import Kit
from hil_tests.report import Verdict

serial_test = importlib.import_module("hil_tests.4_serial")


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_test, "LISTEN_S", 0.3)


def kit(port: str, out: Path) -> Kit:
    return Kit(merge(Config(), {"pose_output": {"port": port}}), None, None, out)


@contextmanager
def adapter(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    """Open a pseudo-terminal; its far end replies with `answer` of what it reads."""
    ours, theirs = pty.openpty()

    def serve() -> None:
        while True:
            try:
                received = os.read(ours, 4096)
            except OSError:
                return
            if received and (reply := answer(received)):
                os.write(ours, reply)

    threading.Thread(target=serve, daemon=True).start()
    try:
        yield os.ttyname(theirs)
    finally:
        os.close(theirs)


def verdicts(port: str, out: Path) -> dict[str, Verdict]:
    return {row.what: row.verdict for row in serial_test.rows(kit(port, out))}


def test_a_wired_loop_is_received(tmp_path: Path) -> None:
    with adapter(lambda received: received) as port:
        assert verdicts(port, tmp_path) == {"writing": Verdict.PASS, "an answer": Verdict.PASS}


def test_silence_is_skipped_and_noise_fails(tmp_path: Path) -> None:
    with adapter(lambda _: b"") as port:
        assert verdicts(port, tmp_path)["an answer"] is Verdict.SKIP
    with adapter(lambda _: b"noise") as port:
        assert verdicts(port, tmp_path)["an answer"] is Verdict.FAIL


def test_a_port_that_is_not_there_fails_and_none_is_skipped(tmp_path: Path) -> None:
    assert verdicts(str(tmp_path / "no-port"), tmp_path) == {"port": Verdict.FAIL}
    assert verdicts("", tmp_path) == {"port": Verdict.SKIP}
