"""Test 4: messages leave the serial port at its baud rate, and an answer arrives."""

from __future__ import annotations

import time
from collections.abc import Iterator

from hil_tests.kit import Kit
from hil_tests.report import Row, judged, skipped

NAME = "4 serial"
MESSAGES = 60
LISTEN_S = 3.0
MAVLINK_2 = 0xFD
# as long as an ODOMETRY message; zeros, which no receiver parses as one
MESSAGE = bytes(245)


def rows(kit: Kit) -> Iterator[Row]:
    """Yield how fast bytes leave and what comes back."""
    path, baud = kit.config.pose_output.port, kit.config.pose_output.baud
    if not path:
        yield skipped(NAME, "port", "pose_output.port is empty")
        return
    import serial

    try:
        port = serial.Serial(path, baud, timeout=0.05, write_timeout=5.0, exclusive=True)
    except (OSError, ValueError) as error:
        yield judged(NAME, "port", False, f"{path}: {error}", "opens")
        return
    with port:
        port.reset_input_buffer()
        started = time.monotonic()
        try:
            for _ in range(MESSAGES):
                port.write(MESSAGE)
            port.flush()
        except OSError as error:
            yield judged(NAME, "writing", False, f"{path}: {error}", "accepts every byte")
            return
        took_s = time.monotonic() - started
        rate_hz = MESSAGES / took_s
        wanted = f"{kit.config.pose_output.rate_hz:g} poses a second at {baud} baud"
        good = rate_hz >= kit.config.pose_output.rate_hz
        yield judged(
            NAME, "writing", good, f"{rate_hz:.0f} messages a second, {len(MESSAGE)} B each", wanted
        )
        received, end = bytearray(), time.monotonic() + LISTEN_S
        while time.monotonic() < end:
            received += port.read(4096)
    if not received:
        yield skipped(
            NAME, "an answer", "silence: nothing wired to RX, or a receiver that does not send"
        )
        return
    found = received.count(MAVLINK_2)
    is_loop = MESSAGE[:32] in received
    kind = "our own bytes (RX wired to TX)" if is_loop else f"{found} possible MAVLink 2 starts"
    yield judged(
        NAME, "an answer", is_loop or found > 0, f"{len(received)} B received: {kind}", "MAVLink 2"
    )
