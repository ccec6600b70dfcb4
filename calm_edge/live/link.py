"""The recording's end of the socket: offers the newest results, and takes requests of the page."""

from __future__ import annotations

import errno
import logging
import os
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from calm_edge.live.board import Board
from calm_edge.live.wire import Message, WireError, receive

log = logging.getLogger(__name__)

# readers at a time, and a reader that takes nothing for STALL_S is dropped; it may come back
MAX_READERS, STALL_S = 4, 5.0
RETRY_S, POLL_S = 2.0, 0.5
# sent when there is nothing new
BEAT = Message("beat", {}).encoded()
# what the kernel holds of each reader
BUFFER_BYTES = 1 << 17


class Link:
    """Serves a Unix socket from threads of its own; nothing here ever blocks its user.

    path: of the socket, removed at the end. board: encoded messages to be sent. ask: called, in
    another thread, with each message of a reader. fault: why nobody can connect at present. If the
    socket cannot be made, that is tried again every RETRY_S.
    """

    def __init__(self, path: Path, board: Board[bytes], ask: Callable[[Message], None]) -> None:
        self._path, self._board, self._ask = path, board, ask
        self._closed = threading.Event()
        self._readers: frozenset[threading.Thread] = frozenset()
        self._bound = False
        self.fault = ""
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="live-link", daemon=True)
        self._thread.start()

    @property
    def readers(self) -> int:
        """Number of connected readers."""
        return sum(thread.is_alive() for thread in self._readers)

    def close(self, timeout_s: float) -> None:
        """Send what is on the board, and end; readers that take too long get less of it."""
        self._board.close()
        self._closed.set()
        for thread in [*self._readers, self._thread]:
            thread.join(timeout_s / 2)
        if self._bound:
            with suppress(OSError):
                self._path.unlink()

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                with self._listening() as listener:
                    self.fault = ""
                    self._accept(listener)
            except OSError as error:
                fault = f"live: {self._path}: {error.strerror or error}"
                if fault != self.fault:
                    log.warning("%s; no page can connect", fault)
                self.fault = fault
                self._closed.wait(RETRY_S)

    def _listening(self) -> socket.socket:
        """A socket that listens at the path; one that a killed recording left is replaced."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            if answers(self._path):
                raise OSError(errno.EADDRINUSE, "another recording offers its results there")
            with suppress(FileNotFoundError):
                if self._path.is_socket():
                    self._path.unlink()
            # before it has a name, so that nobody else ever can connect
            os.fchmod(listener.fileno(), 0o600)
            listener.bind(str(self._path))
            self._bound = True
            listener.listen(MAX_READERS)
            listener.settimeout(POLL_S)
        except BaseException:
            listener.close()
            raise
        return listener

    def _accept(self, listener: socket.socket) -> None:
        while not self._closed.is_set():
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                continue
            alive = {thread for thread in self._readers if thread.is_alive()}
            if len(alive) >= MAX_READERS:
                connection.close()
                continue
            thread = threading.Thread(
                target=self._send, args=(connection,), name="live-reader", daemon=True
            )
            thread.start()
            # another set, since other threads look at this one
            self._readers = frozenset({*alive, thread})

    def _send(self, connection: socket.socket) -> None:
        """Send a reader what is new until it is gone, or takes nothing for STALL_S."""
        with connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
            connection.settimeout(STALL_S)
            gone = threading.Event()
            threading.Thread(
                target=self._listen, args=(connection, gone), name="live-asks", daemon=True
            ).start()
            version = 0
            try:
                while not gone.is_set():
                    closed = self._board.closed
                    version, new = self._board.changes(version, POLL_S)
                    for _, message in new:
                        connection.sendall(message)
                    if not new:
                        connection.sendall(BEAT)
                    if closed and not new:
                        break
            except TimeoutError:
                self.dropped += 1
                log.warning("the live page takes nothing for %g s; dropped", STALL_S)
            except OSError:
                pass
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _listen(self, connection: socket.socket, gone: threading.Event) -> None:
        """Pass the requests of a reader on until it is gone."""
        try:
            while (message := receive(_Patient(connection))) is not None:
                self._ask(message)
        except (OSError, WireError) as error:
            log.debug("live page: %s", error)
        finally:
            gone.set()


class _Patient:
    """Reads from a socket whose time limit is that of sending."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def read(self, size: int) -> bytes:
        """Read `size` bytes, fewer only at the end; raises OSError."""
        data = b""
        while len(data) < size:
            with suppress(TimeoutError):
                part = self._connection.recv(size - len(data))
                if not part:
                    break
                data += part
        return data


def answers(path: Path) -> bool:
    """Whether somebody listens at a socket."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True
