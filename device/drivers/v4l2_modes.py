"""What sizes and rates a V4L2 camera offers, and which rate to take."""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from device.drivers import v4l2_ioctl as v4l2

ENUM_FRAMESIZES = 0xC02C564A
ENUM_FRAMEINTERVALS = 0xC034564B
DISCRETE = 1
# index pixel_format type | width height, or min max step of each
FRAMESIZE = struct.Struct("=III6I8x")
# index pixel_format width height type | numerator denominator, or min max step of them
FRAMEINTERVAL = struct.Struct("=IIIII6I8x")
# drivers count in hundreds of ns: 29.97 Hz is as good as 30
_SLACK = 0.99


@dataclass(frozen=True, slots=True)
class Mode:
    """A size and the rates offered at it; both ends where the camera takes any between."""

    fourcc: str
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...]


def _asked(io: v4l2.VideoIO, fd: int, request: int, argument: bytearray) -> bool:
    """False at the end of a list, and where a driver keeps none."""
    try:
        io.ioctl(fd, request, argument)
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.ENOTTY):
            return False
        raise
    return True


def sizes(io: v4l2.VideoIO, fd: int, fourcc: str) -> Iterator[tuple[int, int]]:
    """(width, height) in px; the smallest and the largest where it takes any between."""
    for index in range(64):
        argument = bytearray(FRAMESIZE.pack(index, v4l2.code(fourcc), 0, *[0] * 6))
        if not _asked(io, fd, ENUM_FRAMESIZES, argument):
            return
        _, _, kind, *numbers = FRAMESIZE.unpack(argument)
        if kind == DISCRETE:
            yield numbers[0], numbers[1]
            continue
        # smallest, largest and step of the width, then of the height
        yield numbers[0], numbers[3]
        yield numbers[1], numbers[4]
        return


def rates(
    io: v4l2.VideoIO, fd: int, form: v4l2.PixelFormat, asked_hz: float = 0.0
) -> tuple[float, ...]:
    """Hz, the slowest first; empty if it does not say. Where it takes any between two ends: both
    ends, and asked_hz if it lies there.
    """
    found: set[float] = set()
    for index in range(64):
        size = form.width_px, form.height_px
        fields = (index, v4l2.code(form.fourcc), *size, 0, *[0] * 6)
        argument = bytearray(FRAMEINTERVAL.pack(*fields))
        if not _asked(io, fd, ENUM_FRAMEINTERVALS, argument):
            break
        _, _, _, _, kind, *fractions = FRAMEINTERVAL.unpack(argument)
        pairs = [fractions[0:2]] if kind == DISCRETE else [fractions[0:2], fractions[2:4]]
        found.update(round(over / per, 3) for per, over in pairs if per)
        if kind != DISCRETE:
            # anything between is granted: what is asked for counts as offered
            found.update(hz for hz in (asked_hz,) if hz and min(found) < hz < max(found))
            break
    return tuple(sorted(found))


def choose_rate(offered: Sequence[float], asked_hz: float) -> float:
    """The slowest that is not slower than asked, else the fastest there is.

    The driver's own choice is the nearest interval, which may be half of what was asked.
    """
    enough = [rate for rate in offered if rate >= _SLACK * asked_hz]
    if not offered:
        return asked_hz
    return min(enough) if enough else max(offered)


def list_modes(io: v4l2.VideoIO, fd: int) -> Iterator[Mode]:
    """Every format and size; raises OSError."""
    for fourcc in v4l2.formats(io, fd):
        for width, height in sizes(io, fd, fourcc):
            form = v4l2.PixelFormat(fourcc, width, height, 0)
            yield Mode(fourcc, width, height, rates(io, fd, form))
