"""List the image sizes and frame rates of a V4L2 camera, and choose a rate."""

from __future__ import annotations

import errno
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from device.drivers import v4l2_ioctl as v4l2

ENUM_FRAMESIZES = 0xC02C564A
ENUM_FRAMEINTERVALS = 0xC034564B
DISCRETE = 1
# struct v4l2_frmsizeenum: index pixel_format type | width height, or min max step of each
FRAMESIZE = struct.Struct("=III6I8x")
# struct v4l2_frmivalenum:
# index pixel_format width height type | numerator denominator, or min max step of them
FRAMEINTERVAL = struct.Struct("=IIIII6I8x")
# relative tolerance: frame intervals are multiples of 100 ns, and 29.97 Hz is accepted for 30 Hz
_SLACK = 0.99


@dataclass(frozen=True, slots=True)
class Mode:
    """A pixel format and image size, and its frame rates; of a continuous range the two ends."""

    fourcc: str
    width_px: int
    height_px: int
    rates_hz: tuple[float, ...]


def _enumerate(io: v4l2.VideoIO, fd: int, request: int, argument: bytearray) -> bool:
    """Fetch one entry of a list; False after its end or if the driver does not support the list."""
    try:
        io.ioctl(fd, request, argument)
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.ENOTTY):
            return False
        raise
    return True


def sizes(io: v4l2.VideoIO, fd: int, fourcc: str) -> Iterator[tuple[int, int]]:
    """List (width, height) in px; only the smallest and the largest of a continuous range."""
    for index in range(64):
        argument = bytearray(FRAMESIZE.pack(index, v4l2.code(fourcc), 0, *[0] * 6))
        if not _enumerate(io, fd, ENUM_FRAMESIZES, argument):
            return
        _, _, kind, *numbers = FRAMESIZE.unpack(argument)
        if kind == DISCRETE:
            yield numbers[0], numbers[1]
            continue
        # the numbers are minimum, maximum and step of the width, then of the height
        yield numbers[0], numbers[3]
        yield numbers[1], numbers[4]
        return


def rates(
    io: v4l2.VideoIO, fd: int, form: v4l2.PixelFormat, asked_hz: float = 0.0
) -> tuple[float, ...]:
    """List the rates in Hz for a format, ascending; empty if the driver reports none.

    Of a continuous range: its two ends, and asked_hz if it lies between them.
    """
    found: set[float] = set()
    for index in range(64):
        size = form.width_px, form.height_px
        fields = (index, v4l2.code(form.fourcc), *size, 0, *[0] * 6)
        argument = bytearray(FRAMEINTERVAL.pack(*fields))
        if not _enumerate(io, fd, ENUM_FRAMEINTERVALS, argument):
            break
        _, _, _, _, kind, *fractions = FRAMEINTERVAL.unpack(argument)
        pairs = [fractions[0:2]] if kind == DISCRETE else [fractions[0:2], fractions[2:4]]
        found.update(round(over / per, 3) for per, over in pairs if per)
        if kind != DISCRETE:
            # any rate in the range is granted, so count the requested one as offered
            found.update(hz for hz in (asked_hz,) if hz and min(found) < hz < max(found))
            break
    return tuple(sorted(found))


def choose_rate(offered: Sequence[float], asked_hz: float) -> float:
    """Choose the slowest rate of at least asked_hz, else the fastest offered.

    A driver would choose the nearest frame interval, which may mean half the requested rate.
    """
    enough = [rate for rate in offered if rate >= _SLACK * asked_hz]
    if not offered:
        return asked_hz
    return min(enough) if enough else max(offered)


def list_modes(io: v4l2.VideoIO, fd: int) -> Iterator[Mode]:
    """List all formats, sizes and rates; raises OSError."""
    for fourcc in v4l2.formats(io, fd):
        for width, height in sizes(io, fd, fourcc):
            form = v4l2.PixelFormat(fourcc, width, height, 0)
            yield Mode(fourcc, width, height, rates(io, fd, form))
