from __future__ import annotations

import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from device.service import NullNotifier, SystemdNotifier, open_notifier


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[socket.socket]:
    """The service manager's end of NOTIFY_SOCKET."""
    pytest.importorskip("systemd.daemon")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as receiver:
        receiver.bind(str(tmp_path / "notify"))
        receiver.settimeout(2)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.delenv("WATCHDOG_USEC", raising=False)
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        yield receiver


def test_the_manager_hears_every_message(manager: socket.socket) -> None:
    notifier = open_notifier()
    notifier.ready()
    notifier.watchdog()
    notifier.status("recording\n12 keyframes")
    notifier.stopping()
    heard = [manager.recv(1000) for _ in range(4)]
    assert heard == [b"READY=1", b"WATCHDOG=1", b"STATUS=recording 12 keyframes", b"STOPPING=1"]
    assert notifier.watchdog_s is None


def test_an_unchanged_status_is_said_once(manager: socket.socket) -> None:
    notifier = open_notifier()
    notifier.status("live")
    notifier.status("live")
    notifier.status("lost")
    assert [manager.recv(1000), manager.recv(1000)] == [b"STATUS=live", b"STATUS=lost"]


def test_the_watchdog_interval_is_ours_only_with_our_pid(
    manager: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "2500000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()))
    assert open_notifier().watchdog_s == 2.5
    monkeypatch.setenv("WATCHDOG_PID", "1")
    assert open_notifier().watchdog_s is None


def test_a_manager_that_went_away_is_no_error(manager: socket.socket, tmp_path: Path) -> None:
    notifier = open_notifier()
    assert isinstance(notifier, SystemdNotifier)
    manager.close()
    (tmp_path / "notify").unlink()
    notifier.watchdog()


def test_without_a_manager_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notifier = open_notifier()
    assert isinstance(notifier, NullNotifier)
    notifier.ready()
    notifier.watchdog()
    notifier.status("x")
    notifier.stopping()


def test_a_missing_systemd_python_is_said_once_and_tolerated(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", "/nowhere")
    monkeypatch.setitem(sys.modules, "systemd", None)
    assert isinstance(open_notifier(), NullNotifier)
    assert "systemd-python is not installed" in caplog.text
