"""A serial port that never blocks, never raises, and comes back by itself."""

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
    """Whole messages written and dropped; reconnects: times the port was opened again; read:
    bytes that came in.
    """

    written: int = 0
    dropped: int = 0
    reconnects: int = 0
    read: int = 0


class SerialPort:
    """Whole messages out, bytes in, by a thread of its own.

    buffer_bytes: what may wait for a slow reader; beyond it the oldest message is dropped, for
    a fresh pose is worth more. retry_s: between attempts to open a port that is not there.
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
        self._rest = memoryview(b"")
        self._written = self._dropped = self._opened = self._read = 0
        self._lock = threading.Lock()
        self._wake_fd = -1
        self._stopping = threading.Event()
        self._port: Any = None
        self._thread: threading.Thread | None = None
        self._on_bytes: Callable[[bytes], object] | None = None

    @property
    def connected(self) -> bool:
        """The port is open as far as the last write knows."""
        return self._port is not None

    def start(self, on_bytes: Callable[[bytes], object] | None = None) -> None:
        """Starts to write and to read; the port need not be there yet.

        on_bytes: called on the port's thread with what comes in, as it comes; it may write.
        """
        self._on_bytes = on_bytes
        self._wake_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._thread = threading.Thread(target=self._run, name="serial", daemon=True)
        self._thread.start()

    def write(self, message: bytes) -> bool:
        """Takes a message for sending, at once; False when it can never be taken."""
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
        """What waits is sent if the reader takes it; ends within a third of a second whatever it
        does; may be called again.
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
        """The counts so far."""
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
            while self._port is not None and self._more() and time.monotonic() < limit:
                self._exchange()
        finally:
            self._close()

    def _more(self) -> bool:
        """Whether there is something to send; takes the next message when one is out."""
        with self._lock:
            if not self._rest and self._queue:
                message = self._queue.popleft()
                self._queued_bytes -= len(message)
                self._rest = memoryview(message)
        return bool(self._rest)

    def _exchange(self) -> None:
        """Waits until something can be done and does it: some bytes out, some in."""
        try:
            fd = self._port.fileno()
            out = [fd] if self._more() else []
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
            self._rest = self._rest[os.write(fd, self._rest) :]
        except BlockingIOError:
            return
        if not self._rest:
            with self._lock:
                self._written += 1

    def _read_some(self, fd: int) -> None:
        try:
            data = os.read(fd, self._READ_BYTES)
        except BlockingIOError:
            return
        if not data:
            # readable, and nothing there: the other end hung up
            raise OSError("hung up")
        with self._lock:
            self._read += len(data)
        if self._on_bytes is not None:
            self._on_bytes(data)

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

    def _close(self) -> None:
        port, self._port = self._port, None
        if self._rest:
            # of no use without its beginning
            self._rest = memoryview(b"")
            with self._lock:
                self._dropped += 1
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
