"""What the service manager is told: ready, alive, what we are doing, stopping; and its journal."""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable
from syslog import LOG_NOTICE
from typing import Protocol

log = logging.getLogger(__name__)

IDENTIFIER = "calm-edge"
# of the watchdog's interval, between two pings: a manager with a hundred a second to read falls
# behind, and notices a hang late
FEED_SHARE = 0.1


class Notifier(Protocol):
    """One method a message; none of them raises or blocks."""

    watchdog_s: float | None

    def ready(self) -> None:
        """Start-up is complete."""
        ...

    def watchdog(self) -> None:
        """Still alive. Only from the loop that just produced a frame or a pose."""
        ...

    def status(self, text: str, state: str = "") -> None:
        """One line for `systemctl status`.

        state: a word such as RUNNING; when it is another than the last one, the line also goes
        into the journal, with the field CALM_EDGE_STATE.
        """
        ...

    def stopping(self) -> None:
        """A wanted shutdown has begun."""
        ...


class NullNotifier:
    """No service manager started us."""

    watchdog_s: float | None = None

    def ready(self) -> None:
        pass

    def watchdog(self) -> None:
        pass

    def status(self, text: str, state: str = "") -> None:
        pass

    def stopping(self) -> None:
        pass


class SystemdNotifier:
    """Tells systemd. watchdog_s: it kills us after this long without a ping, None if it does not.

    notify: `systemd.daemon.notify`. journal: `systemd.journal.send`, where there is a journal.
    """

    def __init__(
        self,
        notify: Callable[[str], object],
        watchdog_s: float | None,
        journal: Callable[..., object] | None = None,
    ) -> None:
        self.watchdog_s = watchdog_s
        self._notify, self._journal = notify, journal
        self._status = self._state = ""
        self._fed_s = float("-inf")

    def ready(self) -> None:
        self._tell("READY=1")

    def watchdog(self) -> None:
        now_s = time.monotonic()
        if now_s - self._fed_s >= FEED_SHARE * (self.watchdog_s or 0.0):
            self._fed_s = now_s
            self._tell("WATCHDOG=1")

    def status(self, text: str, state: str = "") -> None:
        line = " ".join(text.split())
        if line != self._status:
            self._tell(f"STATUS={line}")
            self._status = line
        if state and state != self._state:
            self._state = state
            self._note(line, state)

    def stopping(self) -> None:
        self._tell("STOPPING=1")

    def _tell(self, message: str) -> None:
        try:
            self._notify(message)
        except OSError as error:
            log.debug("service manager does not listen: %s", error)

    def _note(self, line: str, state: str) -> None:
        if self._journal is None:
            return
        fields = {"CALM_EDGE_STATE": state, "SYSLOG_IDENTIFIER": IDENTIFIER}
        try:
            self._journal(line, PRIORITY=LOG_NOTICE, **fields)
        except OSError as error:
            log.debug("the journal does not listen: %s", error)


def _watchdog_s() -> float | None:
    """WATCHDOG_USEC, when it is meant for this process."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    try:
        return int(os.environ["WATCHDOG_USEC"]) / 1e6
    except (KeyError, ValueError):
        return None


def _stderr_is_the_journal() -> bool:
    """JOURNAL_STREAM names the device and inode of the stream that systemd connected to us."""
    try:
        stream = os.fstat(2)
    except OSError:
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{stream.st_dev}:{stream.st_ino}"


def open_notifier() -> Notifier:
    """The service manager that started this process, or a null object when there is none."""
    if not os.environ.get("NOTIFY_SOCKET"):
        return NullNotifier()
    try:
        from systemd import daemon, journal
    except ImportError:
        log.warning("systemd waits for READY=1, but systemd-python is not installed: make setup")
        return NullNotifier()
    to_journal = journal.send if _stderr_is_the_journal() else None
    return SystemdNotifier(daemon.notify, _watchdog_s(), to_journal)


def log_handler() -> logging.Handler:
    """Where log lines go: to the journal, with level, module and the field CALM_EDGE_LOGGER, when
    it is what listens to our stderr; to stderr otherwise.
    """
    if _stderr_is_the_journal():
        try:
            from systemd import journal
        except ImportError:
            return logging.StreamHandler()
        handler: logging.Handler = journal.JournalHandler(SYSLOG_IDENTIFIER=IDENTIFIER)
        handler.addFilter(_name_the_logger)
        return handler
    return logging.StreamHandler()


def _name_the_logger(record: logging.LogRecord) -> bool:
    record.CALM_EDGE_LOGGER = record.name
    return True
