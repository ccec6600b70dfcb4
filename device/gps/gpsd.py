"""GPS fixes from gpsd, by its JSON protocol (https://gpsd.io/gpsd_json.html)."""

from __future__ import annotations

import json
import logging
import math
import socket
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from device.errors import GpsError
from device.gps.fix import Fix, FixKind, fix
from device.gps.reception import Reception

log = logging.getLogger(__name__)

PREFIX = "gpsd"
PORT = 2947
_WATCH = b'?WATCH={"enable":true,"json":true};\n'
# longer lines are not gpsd's
_LONGEST_LINE = 1 << 16
_MODES = {0: FixKind.NONE, 1: FixKind.NONE, 2: FixKind.TWO_D, 3: FixKind.THREE_D}
_STATUS = {2: FixKind.DIFFERENTIAL, 3: FixKind.RTK, 4: FixKind.RTK_FLOAT, 5: FixKind.ESTIMATED}


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of `gpsd`, `gpsd:HOST` or `gpsd:HOST:PORT`; raises GpsError."""
    name, _, rest = text.partition(":")
    host, colon, port = rest.rpartition(":")
    if not colon:
        host, port = rest, str(PORT)
    if name == PREFIX and port.isdecimal() and 0 < int(port) < 1 << 16:
        return host or "localhost", int(port)
    raise GpsError(f"gps.source = {text}: expected gpsd, gpsd:HOST or gpsd:HOST:PORT")


class Gpsd:
    """Client of a gpsd, which connects again after a failure; now_ns: the clock of the frames."""

    _POLL_S = 0.2

    def __init__(self, address: str, now_ns: Callable[[], int], *, retry_s: float = 1.0) -> None:
        self._host, self._port = parse_address(address)
        self._now_ns, self._retry_s = now_ns, retry_s
        self._name = f"GPS gpsd {self._host}:{self._port}"
        self._reception = Reception(self._name, "fixes", "check with cgps that it has a receiver")
        self._error = ""
        self._stopping = threading.Event()
        self._dops: dict[str, Any] = {}
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Connect in a thread of its own; gpsd need not run yet."""
        self._thread = threading.Thread(target=self._run, name="gpsd", daemon=True)
        self._thread.start()

    def take(self, now_ns: int) -> list[Fix]:
        """Return the fixes since the last call; never waits."""
        return self._reception.take()

    @property
    def fault(self) -> str:
        """What is wrong with gpsd or its receiver; empty while it sends."""
        return self._error or self._reception.fault

    def stop(self) -> None:
        """Disconnect."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2.0)

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                with socket.create_connection((self._host, self._port), timeout=1.0) as found:
                    found.settimeout(self._POLL_S)
                    found.sendall(_WATCH)
                    self._reception.opened()
                    self._error = ""
                    self._receive(found)
            except OSError as error:
                self._report(f"{self._name}: {error.strerror or error}")
            self._stopping.wait(self._retry_s)

    def _receive(self, connection: socket.socket) -> None:
        rest = b""
        while not self._stopping.is_set():
            try:
                data = connection.recv(4096)
            except TimeoutError:
                continue
            if not data:
                raise OSError("closed the connection")
            now_ns = self._now_ns()
            *lines, rest = (rest + data).split(b"\n")
            rest = rest[-_LONGEST_LINE:]
            for line in lines:
                found = self._line(line, now_ns)
                self._reception.heard(found is not None, [] if found is None else [found])

    def _line(self, line: bytes, now_ns: int) -> Fix | None:
        try:
            message = json.loads(line)
            kind = message["class"]
            if kind == "SKY":
                self._dops = message
            return report(message, self._dops, now_ns) if kind == "TPV" else None
        except (ValueError, KeyError, TypeError, RecursionError):
            return None

    def _report(self, error: str) -> None:
        if error != self._error:
            log.warning("%s; trying again every %g s", error, self._retry_s)
        self._error = error


def report(message: dict[str, Any], sky: dict[str, Any], now_ns: int) -> Fix:
    """Convert a TPV report, with the dilutions of the last SKY; raises ValueError, TypeError.

    gpsd's error estimates epx, epy, epv are taken as sigmas; what they are is not documented.
    """

    def number(source: dict[str, Any], key: str) -> float:
        value = source.get(key)
        return math.nan if value is None else float(value)

    kind = _MODES.get(int(message.get("mode", 0)), FixKind.UNKNOWN)
    if kind is FixKind.THREE_D:
        kind = _STATUS.get(int(message.get("status", 1)), kind)
    utc_ns = None
    if message.get("time"):
        utc = datetime.fromisoformat(str(message["time"]))
        since = utc - datetime(1970, 1, 1, tzinfo=UTC)
        utc_ns = ((since.days * 86400 + since.seconds) * 10**6 + since.microseconds) * 1000
    height = number(message, "altHAE")
    if not math.isfinite(height):
        height = number(message, "alt")
    sigma_m = number(message, "epx"), number(message, "epy"), number(message, "epv")
    return fix(
        now_ns,
        utc_ns,
        (number(message, "lat"), number(message, "lon"), height),
        kind,
        sigma_m,
        number(sky, "hdop"),
        number(sky, "vdop"),
        None if sky.get("uSat") is None else int(sky["uSat"]),
    )
