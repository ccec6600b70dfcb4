"""What the service manager is told: ready, alive, what we are doing, stopping."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from typing import Protocol

log = logging.getLogger(__name__)


class Notifier(Protocol):
    """One method a message; none of them raises or blocks."""

    watchdog_s: float | None

    def ready(self) -> None:
        """Start-up is complete."""
        ...

    def watchdog(self) -> None:
        """Still alive. Only from the loop that just produced a frame or a pose."""
        ...

    def status(self, text: str) -> None:
        """One line for `systemctl status`."""
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

    def status(self, text: str) -> None:
        pass

    def stopping(self) -> None:
        pass


class SystemdNotifier:
    """Tells systemd. watchdog_s: it kills us after this long without a ping, None if it does not.

    notify: `systemd.daemon.notify`.
    """

    def __init__(self, notify: Callable[[str], object], watchdog_s: float | None) -> None:
        self.watchdog_s = watchdog_s
        self._notify = notify
        self._status = ""

    def ready(self) -> None:
        self._tell("READY=1")

    def watchdog(self) -> None:
        self._tell("WATCHDOG=1")

    def status(self, text: str) -> None:
        line = " ".join(text.split())
        if line != self._status:
            self._tell(f"STATUS={line}")
            self._status = line

    def stopping(self) -> None:
        self._tell("STOPPING=1")

    def _tell(self, message: str) -> None:
        try:
            self._notify(message)
        except OSError as error:
            log.debug("service manager does not listen: %s", error)


def _watchdog_s() -> float | None:
    """WATCHDOG_USEC, when it is meant for this process."""
    if os.environ.get("WATCHDOG_PID", str(os.getpid())) != str(os.getpid()):
        return None
    try:
        return int(os.environ["WATCHDOG_USEC"]) / 1e6
    except (KeyError, ValueError):
        return None


def open_notifier() -> Notifier:
    """The service manager that started this process, or a null object when there is none."""
    if not os.environ.get("NOTIFY_SOCKET"):
        return NullNotifier()
    try:
        from systemd import daemon
    except ImportError:
        log.warning("systemd waits for READY=1, but systemd-python is not installed: make setup")
        return NullNotifier()
    return SystemdNotifier(daemon.notify, _watchdog_s())
