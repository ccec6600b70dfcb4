"""Messages to systemd: sd_notify(3) state, watchdog pings, and log lines for the journal."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from syslog import LOG_NOTICE
from typing import Protocol

log = logging.getLogger(__name__)

IDENTIFIER = "calm-edge"
# least time between two pings as a share of the watchdog's interval: at a hundred pings a second
# systemd falls behind and detects a hang late
PING_SHARE = 0.1


class Notifier(Protocol):
    """Sender of messages to the service manager; no method raises or blocks."""

    def ready(self) -> None:
        """Report that start-up is complete."""
        ...

    def watchdog(self) -> None:
        """Send a watchdog ping. Call it only after a frame or pose has been delivered."""
        ...

    def status(self, text: str, state: str = "") -> None:
        """Set the line shown by `systemctl status`.

        state: a word such as RUNNING; when it changes, the line is also written to the journal,
        with the field CALM_EDGE_STATE.
        """
        ...

    def stopping(self) -> None:
        """Report that an intended shutdown has begun."""
        ...


class NullNotifier:
    """Notifier for a process that no service manager started: does nothing."""

    def ready(self) -> None:
        pass

    def watchdog(self) -> None:
        pass

    def status(self, text: str, state: str = "") -> None:
        pass

    def stopping(self) -> None:
        pass


class SystemdNotifier:
    """Notifier for systemd.

    notify: `systemd.daemon.notify`. watchdog_s: systemd kills the process after this long without a
    ping. journal: `systemd.journal.send`; None if stderr is not connected to the journal.
    """

    def __init__(
        self,
        notify: Callable[[str], object],
        watchdog_s: float | None,
        journal: Callable[..., object] | None = None,
    ) -> None:
        self._ping_period_s = PING_SHARE * (watchdog_s or 0.0)
        self._notify, self._journal = notify, journal
        self._status = self._state = ""
        self._last_ping_s = float("-inf")

    def ready(self) -> None:
        self._send("READY=1")

    def watchdog(self) -> None:
        now_s = time.monotonic()
        if now_s - self._last_ping_s >= self._ping_period_s:
            self._last_ping_s = now_s
            self._send("WATCHDOG=1")

    def status(self, text: str, state: str = "") -> None:
        line = " ".join(text.split())
        if line != self._status:
            self._send(f"STATUS={line}")
            self._status = line
        if state and state != self._state:
            self._state = state
            self._write_journal(line, state)

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def _send(self, message: str) -> None:
        try:
            self._notify(message)
        except OSError as error:
            log.debug("notification to systemd failed: %s", error)

    def _write_journal(self, line: str, state: str) -> None:
        if self._journal is None:
            return
        fields = {"CALM_EDGE_STATE": state, "SYSLOG_IDENTIFIER": IDENTIFIER}
        try:
            self._journal(line, PRIORITY=LOG_NOTICE, **fields)
        except OSError as error:
            log.debug("writing to the journal failed: %s", error)


def _watchdog_s() -> float | None:
    """Watchdog interval from WATCHDOG_USEC, if it is set for this process."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    try:
        return int(os.environ["WATCHDOG_USEC"]) / 1e6
    except (KeyError, ValueError):
        return None


def _stderr_is_the_journal() -> bool:
    """True if stderr is connected to the journal: device and inode equal JOURNAL_STREAM."""
    try:
        stream = os.fstat(2)
    except OSError:
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{stream.st_dev}:{stream.st_ino}"


def open_notifier() -> Notifier:
    """Return a notifier for the service manager that started this process, if there is one."""
    if not os.environ.get("NOTIFY_SOCKET"):
        return NullNotifier()
    try:
        from systemd import daemon, journal
    except ImportError:
        log.warning(
            "systemd waits for READY=1, but systemd-python is not installed: "
            "pip install systemd-python"
        )
        return NullNotifier()
    to_journal = journal.send if _stderr_is_the_journal() else None
    return SystemdNotifier(daemon.notify, _watchdog_s(), to_journal)


def log_handler() -> logging.Handler:
    """Return a log handler for the journal if stderr is connected to it, else for stderr.

    Journal entries carry level, module and the field CALM_EDGE_LOGGER.
    """
    if _stderr_is_the_journal():
        try:
            from systemd import journal
        except ImportError:
            return logging.StreamHandler()
        handler: logging.Handler = journal.JournalHandler(SYSLOG_IDENTIFIER=IDENTIFIER)
        handler.addFilter(_add_logger_field)
        return handler
    return logging.StreamHandler()


def _add_logger_field(record: logging.LogRecord) -> bool:
    record.CALM_EDGE_LOGGER = record.name
    return True
