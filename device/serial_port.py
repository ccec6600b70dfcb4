"""Non-blocking serial port that reopens itself after a failure and never raises."""

from __future__ import annotations

import logging
import os
import select
import termios
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SerialStats:
    """Counters of a serial port.

    written, dropped: number of messages. reconnects: how often the port was reopened. read: number
    of bytes received.
    """

    written: int = 0
    dropped: int = 0
    reconnects: int = 0
    read: int = 0


class SerialPort:
    """Send whole messages and receive bytes in a thread of its own.

    buffer_bytes: capacity of the send queue; when it is full the oldest message is dropped, since
    newer poses are more useful. retry_s: time between attempts to open a missing port.
    """

    _POLL_S = 0.1
    _READ_BYTES = 4096

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
        self._unsent = memoryview(b"")
        self._written = self._dropped = self._opened = self._read = 0
        self._lock = threading.Lock()
        self._wake_fd = -1
        self._stopping = threading.Event()
        self._port: Any = None
        self._thread: threading.Thread | None = None
        self._on_bytes: Callable[[bytes], object] | None = None

    @property
    def connected(self) -> bool:
        """True while the port is open."""
        return self._port is not None

    def start(self, on_bytes: Callable[[bytes], object] | None = None) -> None:
        """Start the thread; the port need not exist yet.

        on_bytes: called on the port's thread with received bytes; it may call write().
        """
        self._on_bytes = on_bytes
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="serial", daemon=True)
        self._thread.start()

    def write(self, message: bytes) -> bool:
        """Queue a message without blocking; False if it exceeds the queue or after stop()."""
        with self._lock:
            if len(message) > self._buffer_bytes or self._stopping.is_set():
                self._dropped += 1
                return False
            while self._queued_bytes + len(message) > self._buffer_bytes:
                self._queued_bytes -= len(self._queue.popleft())
                self._dropped += 1
            self._queue.append(message)
            self._queued_bytes += len(message)
            self._wake()
        return True

    def stop(self) -> None:
        """Send the queued messages if the receiver accepts them, then close the port.

        Takes at most a third of a second; may be called repeatedly.
        """
        with self._lock:
            self._stopping.set()
            self._wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
            os.close(self._wake_fd)
            self._wake_fd = -1

    def stats(self) -> SerialStats:
        """Return the counters."""
        with self._lock:
            reconnects = max(0, self._opened - 1)
            return SerialStats(self._written, self._dropped, reconnects, self._read)

    def _wake(self) -> None:
        if self._wake_fd >= 0:
            os.eventfd_write(self._wake_fd, 1)

    def _run(self) -> None:
        try:
            while not self._stopping.is_set():
                if self._port is None and not self._open():
                    self._stopping.wait(self._retry_s)
                    continue
                self._exchange()
            limit = time.monotonic() + self._POLL_S
            while self._port is not None and self._has_output() and time.monotonic() < limit:
                self._exchange()
        finally:
            self._close()
            with self._lock:
                # not sent, and never will be
                self._dropped += len(self._queue)
                self._queue.clear()
                self._queued_bytes = 0

    def _has_output(self) -> bool:
        """True if there are bytes to send; takes the next message when the last one is sent."""
        with self._lock:
            if not self._unsent and self._queue:
                message = self._queue.popleft()
                self._queued_bytes -= len(message)
                self._unsent = memoryview(message)
        return bool(self._unsent)

    def _exchange(self) -> None:
        """Wait a limited time until the port is ready, then write and read some bytes."""
        try:
            fd = self._port.fileno()
            out = [fd] if self._has_output() else []
            readable, writable, _ = select.select([fd, self._wake_fd], out, [], self._POLL_S)
            if self._wake_fd in readable:
                os.eventfd_read(self._wake_fd)
            if writable:
                self._write_some(fd)
            if fd in readable:
                self._read_some(fd)
        except (OSError, termios.error) as error:
            self._report(f"{self.path}: lost ({error})")
            self._close()

    def _write_some(self, fd: int) -> None:
        try:
            self._unsent = self._unsent[os.write(fd, self._unsent) :]
        except BlockingIOError:
            return
        if not self._unsent:
            with self._lock:
                self._written += 1

    def _read_some(self, fd: int) -> None:
        try:
            data = os.read(fd, self._READ_BYTES)
        except BlockingIOError:
            return
        if not data:
            # readable, but no data: the device was disconnected
            raise OSError("device disconnected")
        with self._lock:
            self._read += len(data)
        if self._on_bytes is not None:
            self._on_bytes(data)

    def _open(self) -> bool:
        # imported here: only a process that uses a port needs pyserial
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

    def _close(self) -> None:
        port, self._port = self._port, None
        if self._unsent:
            # the rest of a message is useless without its beginning
            self._unsent = memoryview(b"")
            with self._lock:
                self._dropped += 1
        if port is not None:
            # each step may fail on a lost device, and the descriptor must be closed anyway
            for step in (self._flush_or_discard, type(port).close):
                try:
                    step(port)
                except (OSError, termios.error) as error:
                    log.debug("%s: close: %s", self.path, error)

    def _flush_or_discard(self, port: Any) -> None:
        """Wait briefly for unsent bytes, then discard them, as close() would wait up to 30 s."""
        limit = time.monotonic() + self._POLL_S
        while port.out_waiting and time.monotonic() < limit:
            time.sleep(0.005)
        if port.out_waiting:
            port.reset_output_buffer()

    def _report(self, error: str) -> None:
        """Store the error, and log it if it differs from the last one."""
        if error != self.error:
            log.warning("%s; trying again every %g s", error, self._retry_s)
        self.error = error
