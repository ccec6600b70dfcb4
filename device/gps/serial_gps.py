"""GPS receiver on a serial port that sends NMEA."""

from __future__ import annotations

from collections.abc import Callable

from device.gps.fix import Fix
from device.gps.nmea import NmeaParser
from device.gps.reception import Reception
from device.serial_port import SerialPort


class SerialGps:
    """Receiver on a port that reopens itself; now_ns: the clock of the frames."""

    def __init__(self, path: str, baud: int, now_ns: Callable[[], int]) -> None:
        self._now_ns = now_ns
        self._port = SerialPort(path, baud)
        self._parser = NmeaParser()
        self._reception = Reception(f"GPS {path}", "NMEA", f"check gps.baud = {baud}")

    def start(self) -> None:
        """Open the port in a thread of its own; it need not exist yet."""
        self._port.start(self._receive)

    def take(self, now_ns: int) -> list[Fix]:
        """Return the fixes since the last call; never waits."""
        return self._reception.take()

    @property
    def fault(self) -> str:
        """What is wrong with the receiver; empty while it sends."""
        if self._port.error:
            # it is silent from when it is back
            self._reception.opened()
            return f"GPS {self._port.error}"
        return self._reception.fault

    def stop(self) -> None:
        """Close the port."""
        self._port.stop()

    def _receive(self, data: bytes) -> None:
        before = self._parser.sentences
        fixes = self._parser.feed(data, self._now_ns())
        self._reception.heard(self._parser.sentences > before, fixes)
