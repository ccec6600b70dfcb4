from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from device.service import NullNotifier, SystemdNotifier, log_handler, open_notifier


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


def test_every_message_reaches_the_service_manager(manager: socket.socket) -> None:
    notifier = open_notifier()
    notifier.ready()
    notifier.watchdog()
    notifier.status("recording\n12 keyframes")
    notifier.stopping()
    heard = [manager.recv(1000) for _ in range(4)]
    assert heard == [b"READY=1", b"WATCHDOG=1", b"STATUS=recording 12 keyframes", b"STOPPING=1"]


def test_an_unchanged_status_is_sent_once(manager: socket.socket) -> None:
    notifier = open_notifier()
    notifier.status("live")
    notifier.status("live")
    notifier.status("lost")
    assert [manager.recv(1000), manager.recv(1000)] == [b"STATUS=live", b"STATUS=lost"]


@pytest.mark.parametrize(("ours", "pings"), [(True, 1), (False, 2)])
def test_the_watchdog_interval_applies_only_with_our_pid(
    manager: socket.socket, monkeypatch: pytest.MonkeyPatch, ours: bool, pings: int
) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", "60000000")
    monkeypatch.setenv("WATCHDOG_PID", str(os.getpid()) if ours else "1")
    notifier = open_notifier()
    notifier.watchdog()
    notifier.watchdog()
    notifier.stopping()
    heard = [manager.recv(1000) for _ in range(pings + 1)]
    assert heard == [b"WATCHDOG=1"] * pings + [b"STOPPING=1"]


def test_a_service_manager_that_is_gone_is_no_error(manager: socket.socket, tmp_path: Path) -> None:
    notifier = open_notifier()
    assert isinstance(notifier, SystemdNotifier)
    manager.close()
    (tmp_path / "notify").unlink()
    notifier.watchdog()


def test_without_a_service_manager_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    notifier = open_notifier()
    assert isinstance(notifier, NullNotifier)
    notifier.ready()
    notifier.watchdog()
    notifier.status("x")
    notifier.stopping()


def test_missing_systemd_python_is_logged_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", "/nowhere")
    monkeypatch.setitem(sys.modules, "systemd", None)
    assert isinstance(open_notifier(), NullNotifier)
    assert "systemd-python is not installed" in caplog.text


def test_a_state_change_is_written_to_the_journal_once() -> None:
    entries: list[tuple[str, dict[str, object]]] = []
    notifier = SystemdNotifier(lambda _: None, None, lambda text, **f: entries.append((text, f)))
    notifier.status("RUNNING: 3 frames", "RUNNING")
    notifier.status("RUNNING: 9 frames", "RUNNING")
    notifier.status("LOST: no texture", "LOST")
    assert [(text, f["CALM_EDGE_STATE"]) for text, f in entries] == [
        ("RUNNING: 3 frames", "RUNNING"),
        ("LOST: no texture", "LOST"),
    ]
    assert {f["SYSLOG_IDENTIFIER"] for _, f in entries} == {"calm-edge"}


def test_a_journal_that_is_gone_is_no_error() -> None:
    def gone(*_: object, **__: object) -> None:
        raise OSError

    SystemdNotifier(lambda _: None, None, gone).status("x", "RUNNING")


def test_log_lines_go_to_the_journal_only_if_stderr_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    journal = pytest.importorskip("systemd.journal")
    monkeypatch.setenv("JOURNAL_STREAM", "1:1")
    assert type(log_handler()) is logging.StreamHandler
    stream = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stream.st_dev}:{stream.st_ino}")
    sent: list[dict[str, object]] = []
    monkeypatch.setattr(journal, "send", lambda _, **fields: sent.append(fields))
    handler = log_handler()
    assert isinstance(handler, journal.JournalHandler)
    handler.send = journal.send
    handler.handle(logging.LogRecord("device.stream", logging.ERROR, "f", 1, "gone", None, None))
    assert sent[0]["CALM_EDGE_LOGGER"] == "device.stream" and sent[0]["PRIORITY"] == "3"
    assert sent[0]["SYSLOG_IDENTIFIER"] == "calm-edge"


def test_watchdog_pings_are_rate_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("device.service.time", SimpleNamespace(monotonic=lambda: now_s[0]))
    sent: list[float] = []
    notifier = SystemdNotifier(lambda _: sent.append(now_s[0]), 5.0)
    for tick in range(200):
        now_s[0] = 100.0 + tick * 0.01
        notifier.watchdog()
    assert sent == pytest.approx([100.0, 100.5, 101.0, 101.5])
