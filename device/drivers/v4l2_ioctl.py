"""Video4Linux2 ioctl calls, with the packed structs of 64-bit Linux (<linux/videodev2.h>)."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import select
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from device.drivers import v4l2_identity
from device.drivers.v4l2_identity import NodeFacts

QUERYCAP = 0x80685600
ENUM_FMT = 0xC0405602
S_FMT = 0xC0D05605
S_PARM = 0xC0CC5616
REQBUFS = 0xC0145608
QUERYBUF = 0xC0585609
QBUF = 0xC058560F
DQBUF = 0xC0585611
STREAMON = 0x40045612
STREAMOFF = 0x40045613

CAP_VIDEO_CAPTURE = 0x00000001
CAP_VIDEO_CAPTURE_MPLANE = 0x00001000
CAP_STREAMING = 0x04000000
CAP_DEVICE_CAPS = 0x80000000
BUF_TYPE_VIDEO_CAPTURE = 1
FIELD_NONE = 1
MEMORY_MMAP = 1
BUF_FLAG_ERROR = 0x0040
BUF_FLAG_TIMESTAMP_MASK = 0xE000
BUF_FLAG_TIMESTAMP_MONOTONIC = 0x2000

# pad bytes (x) replace unused fields, which stay zero
CAPABILITY = struct.Struct("=16s32s32sIII12x")
FMTDESC = struct.Struct("=III32sI16x")
# struct v4l2_format with fmt.pix; the union fmt is 200 bytes long and aligned to 8
FORMAT = struct.Struct("=I4xIIIIII176x")
# struct v4l2_streamparm: type | capability capturemode, numerator and denominator of timeperframe
STREAMPARM = struct.Struct("=IIIII184x")
REQUESTBUFFERS = struct.Struct("=III8x")
# struct v4l2_buffer:
# index type bytesused flags field | tv_sec tv_usec | timecode | sequence memory | offset | length
BUFFER = struct.Struct("=IIIII4xqq16xIII4xI12x")


@dataclass(frozen=True, slots=True)
class Capability:
    """Result of QUERYCAP.

    capabilities: flags of this node if the driver reports them, else of the whole device.
    """

    driver: str
    card: str
    bus_info: str
    capabilities: int

    @property
    def captures(self) -> bool:
        """True if the node streams video; a metadata node does not."""
        wanted = CAP_VIDEO_CAPTURE | CAP_STREAMING
        return self.capabilities & wanted == wanted

    @property
    def multiplanar(self) -> bool:
        """True if the node streams video by the multi-planar API alone."""
        wanted = CAP_VIDEO_CAPTURE_MPLANE | CAP_STREAMING
        return self.capabilities & wanted == wanted and not self.captures


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """Format of the images: fourcc as 4 characters, size, and bytes per row.

    stride_bytes: 0 for compressed formats.
    """

    fourcc: str
    width_px: int
    height_px: int
    stride_bytes: int


@dataclass(frozen=True, slots=True)
class Buffer:
    """A filled buffer. t_ns: CLOCK_MONOTONIC, None if the driver gives no such stamp."""

    index: int
    sequence: int
    bytes_used: int
    t_ns: int | None
    corrupt: bool


class VideoIO(Protocol):
    """System calls used by the V4L2 driver; each may raise OSError. Tests replace them."""

    def nodes(self) -> list[str]:
        """Paths of the video nodes, in the order of their numbers."""
        ...

    def open(self, path: str) -> int: ...

    def close(self, fd: int) -> None: ...

    def ioctl(self, fd: int, request: int, argument: bytearray) -> None:
        """Call ioctl(2); the argument is changed in place."""
        ...

    def map(self, fd: int, length: int, offset: int) -> mmap.mmap | bytearray: ...

    def unmap(self, memory: mmap.mmap | bytearray) -> None: ...

    def wait(self, fd: int, timeout_s: float) -> bool:
        """Wait until a buffer or an error can be fetched; False after timeout_s."""
        ...

    def facts(self, path: str) -> NodeFacts:
        """Return serial number and port of a node."""
        ...

    def holders(self, path: str) -> list[str]:
        """Return the processes that have a node open."""
        ...


class LinuxVideoIO:
    """The system calls of Linux. folder: directory of the video nodes."""

    def __init__(self, folder: Path = Path("/dev")) -> None:
        self._folder = folder

    def nodes(self) -> list[str]:
        found = [p for p in self._folder.glob("video*") if p.name[5:].isdecimal()]
        return [str(p) for p in sorted(found, key=lambda p: int(p.name[5:]))]

    def open(self, path: str) -> int:
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self, fd: int) -> None:
        os.close(fd)

    def ioctl(self, fd: int, request: int, argument: bytearray) -> None:
        fcntl.ioctl(fd, request, argument)

    def map(self, fd: int, length: int, offset: int) -> mmap.mmap | bytearray:
        return mmap.mmap(fd, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)

    def unmap(self, memory: mmap.mmap | bytearray) -> None:
        if isinstance(memory, mmap.mmap):
            memory.close()

    def wait(self, fd: int, timeout_s: float) -> bool:
        return bool(select.select([fd], [], [], timeout_s)[0])

    def facts(self, path: str) -> NodeFacts:
        return v4l2_identity.facts(path)

    def holders(self, path: str) -> list[str]:
        return v4l2_identity.holders(path)


def text(field: bytes) -> str:
    """Decode a zero-terminated C string."""
    return field.partition(b"\0")[0].decode(errors="replace")


def code(fourcc: str) -> int:
    """Encode a four-character code as its 32-bit number."""
    return int.from_bytes(fourcc.encode("latin-1"), "little")


def query_capability(io: VideoIO, fd: int) -> Capability:
    """QUERYCAP: read driver, name, bus and capabilities of a node; raises OSError."""
    argument = bytearray(CAPABILITY.size)
    io.ioctl(fd, QUERYCAP, argument)
    driver, card, bus_info, _, capabilities, device_caps = CAPABILITY.unpack(argument)
    if capabilities & CAP_DEVICE_CAPS:
        capabilities = device_caps
    return Capability(text(driver), text(card), text(bus_info), capabilities)


def formats(io: VideoIO, fd: int) -> Iterator[str]:
    """ENUM_FMT: the fourccs of the offered pixel formats; raises OSError."""
    for index in range(64):
        argument = bytearray(FMTDESC.pack(index, BUF_TYPE_VIDEO_CAPTURE, 0, b"", 0))
        try:
            io.ioctl(fd, ENUM_FMT, argument)
        except OSError as error:
            # EINVAL marks the end of the list
            if error.errno == errno.EINVAL:
                return
            raise
        fourcc: int = FMTDESC.unpack(argument)[4]
        yield fourcc.to_bytes(4, "little").decode("latin-1")


def set_format(io: VideoIO, fd: int, fourcc: str, width_px: int, height_px: int) -> PixelFormat:
    """S_FMT: request a format and return the one the camera chose; raises OSError."""
    argument = bytearray(
        FORMAT.pack(BUF_TYPE_VIDEO_CAPTURE, width_px, height_px, code(fourcc), FIELD_NONE, 0, 0)
    )
    io.ioctl(fd, S_FMT, argument)
    _, width, height, got, _, stride, _ = FORMAT.unpack(argument)
    return PixelFormat(got.to_bytes(4, "little").decode("latin-1"), width, height, stride)


def set_rate(io: VideoIO, fd: int, rate_hz: float) -> float:
    """S_PARM: request a rate; return the one set in Hz, 0 if not reported; raises OSError."""
    per_frame = (1000, round(rate_hz * 1000))
    argument = bytearray(STREAMPARM.pack(BUF_TYPE_VIDEO_CAPTURE, 0, 0, *per_frame))
    io.ioctl(fd, S_PARM, argument)
    _, _, _, numerator, denominator = STREAMPARM.unpack(argument)
    return float(denominator / numerator) if numerator else 0.0


def request_buffers(io: VideoIO, fd: int, count: int) -> int:
    """REQBUFS: allocate buffers and return how many; count 0 frees them; raises OSError."""
    argument = bytearray(REQUESTBUFFERS.pack(count, BUF_TYPE_VIDEO_CAPTURE, MEMORY_MMAP))
    io.ioctl(fd, REQBUFS, argument)
    return int(REQUESTBUFFERS.unpack(argument)[0])


def _buffer_argument(index: int) -> bytearray:
    fields = (index, BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0, 0, 0, MEMORY_MMAP, 0, 0)
    return bytearray(BUFFER.pack(*fields))


def map_buffer(io: VideoIO, fd: int, index: int) -> mmap.mmap | bytearray:
    """QUERYBUF and mmap(2): map a buffer into memory; raises OSError."""
    argument = _buffer_argument(index)
    io.ioctl(fd, QUERYBUF, argument)
    *_, offset, length = BUFFER.unpack(argument)
    return io.map(fd, length, offset)


def queue_buffer(io: VideoIO, fd: int, index: int) -> None:
    """QBUF: return a buffer to the driver to be filled; raises OSError."""
    io.ioctl(fd, QBUF, _buffer_argument(index))


def dequeue_buffer(io: VideoIO, fd: int) -> Buffer:
    """DQBUF: take a filled buffer; raises BlockingIOError if there is none, else OSError."""
    argument = _buffer_argument(0)
    io.ioctl(fd, DQBUF, argument)
    index, _, used, flags, _, tv_sec, tv_usec, sequence, *_ = BUFFER.unpack(argument)
    monotonic = flags & BUF_FLAG_TIMESTAMP_MASK == BUF_FLAG_TIMESTAMP_MONOTONIC
    t_ns = tv_sec * 1_000_000_000 + tv_usec * 1000
    # some drivers declare monotonic stamps but leave them zero
    stamp = t_ns if monotonic and t_ns > 0 else None
    return Buffer(index, sequence, used, stamp, bool(flags & BUF_FLAG_ERROR))


def stream(io: VideoIO, fd: int, on: bool) -> None:
    """STREAMON or STREAMOFF: start or stop streaming; raises OSError."""
    argument = bytearray(struct.pack("=i", BUF_TYPE_VIDEO_CAPTURE))
    io.ioctl(fd, STREAMON if on else STREAMOFF, argument)
