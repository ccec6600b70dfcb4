"""UDP socket that sends whole messages to one address, never blocks and never raises."""

from __future__ import annotations

import logging
import select
import socket
import threading
import time
from collections.abc import Callable

from device.errors import DeviceError
from device.serial_port import SerialStats

log = logging.getLogger(__name__)

PREFIX = "udp:"


class UdpAddressError(DeviceError):
    """An address is not `udp:HOST:PORT`."""


def parse_udp(text: str) -> tuple[str, int]:
    """Host and port of `udp:HOST:PORT`, an IPv6 host in brackets; raises UdpAddressError."""
    host, colon, port = text.removeprefix(PREFIX).rpartition(":")
    if text.startswith(PREFIX) and colon and host and port.isdecimal() and 0 < int(port) < 1 << 16:
        bare = host.removeprefix("[").removesuffix("]")
        if ":" not in bare or host != bare:
            return bare, int(port)
    raise UdpAddressError(f"{text}: expected udp:HOST:PORT, e.g. udp:192.168.1.10:14550")


class UdpPort:
    """Send each message as a datagram, and receive datagrams in a thread of its own.

    address: `udp:HOST:PORT`. retry_s: time between attempts to resolve the host's name, and after
    which a refusal (nobody listens on that port) counts as over. The interface is that of
    SerialPort. Raises UdpAddressError.
    """

    _POLL_S = 0.1
    _READ_BYTES = 65_536

    def __init__(self, address: str, *, retry_s: float = 1.0) -> None:
        self.path = address
        self._host, self._number = parse_udp(address)
        self._retry_s = retry_s
        self._socket: socket.socket | None = None
        self._error = ""
        self._error_s = 0.0
        self._written = self._dropped = self._opened = self._read = 0
        self._lock = threading.Lock()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._on_bytes: Callable[[bytes], object] | None = None

    @property
    def connected(self) -> bool:
        """True while messages can be sent, as far as is known."""
        return self._socket is not None and self.error is None

    @property
    def error(self) -> str | None:
        """Why messages are not sent or not received at present; None if they are."""
        over = self._socket is not None and time.monotonic() - self._error_s > 2 * self._retry_s
        return None if over or not self._error else self._error

    def start(self, on_bytes: Callable[[bytes], object] | None = None) -> None:
        """Start the thread. on_bytes: called on it with each received datagram."""
        self._on_bytes = on_bytes
        # at once for an address in digits, so that the first messages are sent
        self._open(socket.AI_NUMERICHOST)
        self._thread = threading.Thread(target=self._run, name="udp", daemon=True)
        self._thread.start()

    def write(self, message: bytes) -> bool:
        """Send a message without blocking; False if it was lost, as far as is known."""
        with self._lock:
            if self._socket is None:
                self._dropped += 1
                return False
            try:
                self._socket.send(message)
            except BlockingIOError:
                self._dropped += 1
                return False
            except OSError as error:
                # a refusal is that of the message before
                self._report(error)
                self._dropped += 1
                return False
            self._written += 1
            return True

    def stop(self) -> None:
        """Close the socket; may be called repeatedly."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._lock:
            if self._socket is not None:
                self._socket.close()
                self._socket = None

    def stats(self) -> SerialStats:
        """Return the counters; read is in bytes."""
        with self._lock:
            reconnects = max(0, self._opened - 1)
            return SerialStats(self._written, self._dropped, reconnects, self._read)

    def _open(self, flags: int = 0) -> None:
        """Resolve the name and connect a socket."""
        try:
            found = socket.getaddrinfo(
                self._host, self._number, type=socket.SOCK_DGRAM, flags=flags
            )
            family, kind, protocol, _, address = found[0]
            made = socket.socket(family, kind, protocol)
            made.setblocking(False)
            made.connect(address)
        except OSError as error:
            if not flags:
                self._report(error)
            return
        with self._lock:
            self._socket = made
            self._error = ""
        self._opened += 1

    def _run(self) -> None:
        while not self._stopping.is_set():
            if self._socket is None:
                self._open()
                if self._socket is None:
                    self._stopping.wait(self._retry_s)
                continue
            self._receive(self._socket)

    def _receive(self, open_socket: socket.socket) -> None:
        try:
            readable, _, _ = select.select([open_socket], [], [], self._POLL_S)
            data = open_socket.recv(self._READ_BYTES) if readable else b""
        except BlockingIOError:
            return
        except OSError as error:
            self._report(error)
            return
        if not data:
            return
        with self._lock:
            self._read += len(data)
            self._error = ""
        if self._on_bytes is not None:
            self._on_bytes(data)

    def _report(self, error: OSError) -> None:
        """Keep the error; log it if it is another one than before."""
        refused = isinstance(error, ConnectionRefusedError)
        why = "nobody listens there" if refused else f"cannot be used ({error.strerror or error})"
        text = f"{self.path}: {why}"
        if text != self._error:
            log.warning("%s; trying on", text)
        self._error, self._error_s = text, time.monotonic()
