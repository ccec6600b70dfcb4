"""Receivers of GPS fixes: a serial device that sends NMEA, or gpsd."""

from __future__ import annotations

from collections.abc import Callable

from device.gps import gpsd
from device.gps.gpsd import Gpsd
from device.gps.serial_gps import SerialGps

_DEVICES = "/dev/"


def is_receiver(source: str) -> bool:
    """Whether a source is a receiver, not a file of fixes."""
    return source.partition(":")[0] == gpsd.PREFIX or source.startswith(_DEVICES)


def receiver(source: str, baud: int, now_ns: Callable[[], int]) -> SerialGps | Gpsd:
    """Make the receiver of a source, not yet started; raises GpsError.

    now_ns: the clock of the frames.
    """
    if source.startswith(_DEVICES):
        return SerialGps(source, baud, now_ns)
    return Gpsd(source, now_ns)
