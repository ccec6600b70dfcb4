"""A serial port to write to and forget: it never blocks, never raises, and comes back by itself."""

from __future__ import annotations

import logging
import os
import select
import termios
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SerialStats:
    """Whole messages written and dropped; reconnects: times the port was opened again."""

    written: int = 0
    dropped: int = 0
    reconnects: int = 0


class SerialPort:
    """Write-only, whole messages, by a thread of its own.

    buffer_bytes: what may wait for a slow reader; beyond it the oldest message is dropped, for
    a fresh pose is worth more. retry_s: between attempts to open a port that is not there.
    """

    _POLL_S = 0.1

    def __init__(
        self, path: str, baud: int, *, buffer_bytes: int = 2048, retry_s: float = 1.0
    ) -> None:
        self.path = path
        self.baud = baud
        self.error: str | None = None
        self._buffer_bytes = buffer_bytes
        self._retry_s = retry_s
        self._queue: deque[bytes] = deque()
        self._queued_bytes = 0
        self._written = self._dropped = self._opened = 0
        self._wake = threading.Condition()
        self._stopping = threading.Event()
        self._port: Any = None
        self._thread: threading.Thread | None = None

    @property
    def connected(self) -> bool:
        """The port is open as far as the last write knows."""
        return self._port is not None

    def start(self) -> None:
        """Starts to write; the port need not be there yet."""
        self._thread = threading.Thread(target=self._run, name="serial", daemon=True)
        self._thread.start()

    def write(self, message: bytes) -> bool:
        """Takes a message for sending, at once; False when it can never be taken."""
        with self._wake:
            if len(message) > self._buffer_bytes or self._stopping.is_set():
                self._dropped += 1
                return False
            while self._queued_bytes + len(message) > self._buffer_bytes:
                self._queued_bytes -= len(self._queue.popleft())
                self._dropped += 1
            self._queue.append(message)
            self._queued_bytes += len(message)
            self._wake.notify()
        return True

    def stop(self) -> None:
        """Ends within a fifth of a second, whatever the reader does; may be called again."""
        self._stopping.set()
        with self._wake:
            self._wake.notify()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def stats(self) -> SerialStats:
        """The counts so far."""
        with self._wake:
            return SerialStats(self._written, self._dropped, max(0, self._opened - 1))

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                if self._port is None and not self._open():
                    self._stopping.wait(self._retry_s)
                    continue
                message = self._take()
                if message is not None:
                    self._send(message)
        finally:
            self._close()

    def _take(self) -> bytes | None:
        with self._wake:
            if not self._queue:
                self._wake.wait(self._POLL_S)
            if not self._queue:
                return None
            message = self._queue.popleft()
            self._queued_bytes -= len(message)
            return message

    def _open(self) -> bool:
        # here, not above: only a process with a port needs pyserial
        import serial

        try:
            self._port = serial.Serial(self.path, self.baud, exclusive=True)
        except (OSError, ValueError, termios.error) as error:
            self._report(f"{self.path}: cannot be opened ({error})")
            return False
        self._opened += 1
        self.error = None
        log.info("%s: open at %d baud", self.path, self.baud)
        return True

    def _send(self, message: bytes) -> None:
        """The whole message, or as much as could be written before the port was lost or stopped."""
        rest = memoryview(message)
        try:
            while rest and not self._stopping.is_set():
                fd = self._port.fileno()
                if select.select([], [fd], [], self._POLL_S)[1]:
                    rest = rest[self._write_some(fd, rest) :]
        except (OSError, termios.error) as error:
            self._report(f"{self.path}: lost ({error})")
            self._close()
        with self._wake:
            if rest:
                self._dropped += 1
            else:
                self._written += 1

    @staticmethod
    def _write_some(fd: int, rest: memoryview) -> int:
        try:
            return os.write(fd, rest)
        except BlockingIOError:
            return 0

    def _close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            # each may fail on a vanished device, and the descriptor must not stay open
            for step in (self._let_go, type(port).close):
                try:
                    step(port)
                except (OSError, termios.error) as error:
                    log.debug("%s: close: %s", self.path, error)

    def _let_go(self, port: Any) -> None:
        """Bytes a stalled reader never takes are thrown away: the kernel would wait 30 s."""
        limit = time.monotonic() + self._POLL_S
        while port.out_waiting and time.monotonic() < limit:
            time.sleep(0.005)
        if port.out_waiting:
            port.reset_output_buffer()

    def _report(self, error: str) -> None:
        """Keeps the fault, and logs it when it is news."""
        if error != self.error:
            log.warning("%s; trying again every %g s", error, self._retry_s)
        self.error = error
