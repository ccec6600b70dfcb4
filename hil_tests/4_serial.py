"""Do messages leave the serial port at its baud rate, and does anyone answer?"""

from __future__ import annotations

import time
from collections.abc import Iterator

from hil_tests.kit import Kit
from hil_tests.report import Row, judged, skipped

NAME = "4 serial"
WRITTEN = 60
LISTENED_S = 3.0
MAVLINK_2 = 0xFD
# the length of an ODOMETRY message; these bytes are zeros, which no receiver takes for one
MESSAGE = bytes(245)


def rows(kit: Kit) -> Iterator[Row]:
    """How fast bytes leave, and what comes back."""
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
            for _ in range(WRITTEN):
                port.write(MESSAGE)
            port.flush()
        except OSError as error:
            yield judged(NAME, "writing", False, f"{path}: {error}", "takes every byte")
            return
        took_s = time.monotonic() - started
        rate_hz = WRITTEN / took_s
        wanted = f"{kit.config.pose_output.rate_hz:g} poses a second at {baud} baud"
        good = rate_hz >= kit.config.pose_output.rate_hz
        yield judged(
            NAME, "writing", good, f"{rate_hz:.0f} messages a second, {len(MESSAGE)} B each", wanted
        )
        heard, end = bytearray(), time.monotonic() + LISTENED_S
        while time.monotonic() < end:
            heard += port.read(4096)
    if not heard:
        yield skipped(NAME, "an answer", "silence: nothing wired to RX, or a receiver that is mute")
        return
    found = heard.count(MAVLINK_2)
    looped = MESSAGE[:32] in heard
    kind = "our own bytes (RX wired to TX)" if looped else f"{found} possible MAVLink 2 starts"
    yield judged(
        NAME, "an answer", looped or found > 0, f"{len(heard)} B heard: {kind}", "MAVLink 2"
    )
