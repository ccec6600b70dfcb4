from __future__ import annotations

import errno
import os
import threading

import pytest

from device import realtime


def test_priority_zero_makes_no_system_call(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: pytest.fail("must not be called"))
    assert realtime.request(0) is None


def test_only_the_calling_thread_gets_the_priority() -> None:
    outcome: list[object] = []

    def ask() -> None:
        refused = realtime.request(3)
        outcome.extend([refused, os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK])

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    refused, policy = outcome
    # an unprivileged user is refused, root is not: the return value tells which
    assert policy == (os.SCHED_OTHER if refused else os.SCHED_FIFO)
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_a_refusal_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert "LimitRTPRIO" in str(realtime.request(5))


def test_an_invalid_priority_is_reported() -> None:
    assert "from 1 to 99" in str(realtime.request(100))
