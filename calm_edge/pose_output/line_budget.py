"""Check that the serial line can carry the messages at the configured pose rate."""

from __future__ import annotations

from calm_edge.config import ConfigError, PoseOutputConfig
from calm_edge.pose_output.mavlink import (
    MAX_STATUS_TEXTS,
    Heartbeat,
    Odometry,
    StatusText,
    Timesync,
    wire_bytes,
)

# upper limits of status texts (each of several chunks) and of TIMESYNC replies per second
TEXTS_HZ, ANSWERS_HZ = 1, 20
# a byte takes ten bits with start and stop bit; a tenth of the line's capacity stays free
_BITS_A_BYTE, _LINE_SHARE = 10, 0.9
_BESIDE_POSES = (
    wire_bytes(Heartbeat)
    + TEXTS_HZ * MAX_STATUS_TEXTS * wire_bytes(StatusText)
    + ANSWERS_HZ * wire_bytes(Timesync)
)


def bytes_per_second(rate_hz: float) -> float:
    """Upper bound of bytes sent per second at a given pose rate."""
    return rate_hz * wire_bytes(Odometry) + _BESIDE_POSES


def check_rate(config: PoseOutputConfig, *, limited: bool = True) -> None:
    """Raise ConfigError if the line cannot carry pose_output.rate_hz at pose_output.baud.

    limited: False for a network, which has no baud.
    """
    if not config.rate_hz > 0:
        raise ConfigError(f"pose_output.rate_hz = {config.rate_hz:g}: must be above 0")
    capacity = config.baud / _BITS_A_BYTE * _LINE_SHARE
    if limited and bytes_per_second(config.rate_hz) > capacity:
        most = max(0, int((capacity - _BESIDE_POSES) / wire_bytes(Odometry)))
        raise ConfigError(
            f"pose_output.baud = {config.baud}: carries {most} poses per second, but "
            f"pose_output.rate_hz = {config.rate_hz:g}; raise baud or lower rate_hz"
        )
