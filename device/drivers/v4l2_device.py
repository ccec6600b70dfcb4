"""One open video node, and how to find the right one: by bus, never by node number."""

from __future__ import annotations

import contextlib
import errno
import mmap
from dataclasses import dataclass

from device.drivers import v4l2_ioctl as v4l2
from device.errors import CameraError
from device.frame import Eye

_MENDS = {
    errno.EACCES: "permission denied; add the user to the group video and log in again",
    errno.EPERM: "permission denied; add the user to the group video and log in again",
    errno.EBUSY: "in use by another program; close it",
    errno.ENOSPC: (
        "no USB bandwidth left for it; plug the cameras into different USB controllers, "
        "or lower capture.width_px, capture.height_px or capture.rate_hz"
    ),
}
# MJPEG first: the camera's own bytes go to disk untouched, and fit through USB
_WANTED = ("MJPG", "JPEG", "YUYV")


def explain(what: str, error: OSError) -> CameraError:
    """One line for an OSError at a camera, with the mend where we know one."""
    return CameraError(f"{what}: {_MENDS.get(error.errno or 0, error.strerror or str(error))}")


@dataclass(frozen=True, slots=True)
class VideoNode:
    """A node that captures. address: its identity, `BUS_INFO`, or `BUS_INFO#1` for the second
    capturing node on the same bus.
    """

    path: str
    card: str
    driver: str
    address: str


def list_devices(io: v4l2.VideoIO | None = None) -> list[VideoNode]:
    """Every camera that can be opened, by node number; raises CameraError if none may be."""
    io = io or v4l2.LinuxVideoIO()
    nodes: list[VideoNode] = []
    denied: CameraError | None = None
    on_bus: dict[str, int] = {}
    for path in io.nodes():
        try:
            fd = io.open(path)
            try:
                capability = v4l2.query_capability(io, fd)
            finally:
                io.close(fd)
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EPERM):
                denied = explain(path, error)
            continue
        if not capability.captures:
            continue
        nth = on_bus[capability.bus_info] = on_bus.get(capability.bus_info, -1) + 1
        address = capability.bus_info + (f"#{nth}" if nth else "")
        nodes.append(VideoNode(path, capability.card, capability.driver, address))
    if denied is not None and not nodes:
        raise denied
    return nodes


def find(address: str, eye: Eye, io: v4l2.VideoIO) -> VideoNode:
    """The node of an address: a bus, a /dev/videoN, or empty: cameras sorted by bus, the
    primary takes the first and the assistant the second. Raises CameraError.
    """
    nodes = list_devices(io)
    name = f"{eye.name.lower()} camera v4l2:{address}"
    known = ", ".join(node.address for node in nodes) or "no camera at all"
    if not address:
        ordered = sorted(nodes, key=lambda node: node.address)
        if len(ordered) > eye:
            return ordered[eye]
        raise CameraError(f"{name}: {len(nodes)} found ({known}); plug in camera {eye + 1}")
    for node in nodes:
        if address in (node.address, node.path):
            return node
    raise CameraError(f"{name}: not there; found: {known}")


class VideoDevice:
    """An open node that streams. Opening raises CameraError; all else OSError when it is lost."""

    def __init__(
        self, io: v4l2.VideoIO, node: VideoNode, width_px: int, height_px: int, rate_hz: float
    ) -> None:
        self._io = io
        self._what = f"camera {node.address} ({node.path})"
        self._buffers: list[mmap.mmap | bytearray] = []
        self._open = False
        try:
            self._fd = io.open(node.path)
            self._open = True
            self.format = self._negotiate(width_px, height_px)
            self.rate_hz = self._set_rate(rate_hz)
            self._start()
        except OSError as error:
            self.close()
            raise explain(self._what, error) from None
        except CameraError:
            self.close()
            raise

    def dequeue(self, timeout_s: float) -> tuple[v4l2.Buffer, bytes] | None:
        """The next filled buffer and a copy of its bytes; None after timeout_s without one."""
        if not self._io.wait(self._fd, timeout_s):
            return None
        try:
            buffer = v4l2.dequeue_buffer(self._io, self._fd)
        except BlockingIOError:
            return None
        data = bytes(self._buffers[buffer.index][: buffer.bytes_used])
        v4l2.queue_buffer(self._io, self._fd, buffer.index)
        return buffer, data

    def close(self) -> None:
        """Lets go of everything; a node that is gone has nothing left to refuse."""
        if not self._open:
            return
        self._open = False
        with contextlib.suppress(OSError):
            v4l2.stream(self._io, self._fd, False)
        for buffer in self._buffers:
            self._io.unmap(buffer)
        self._buffers.clear()
        with contextlib.suppress(OSError):
            v4l2.request_buffers(self._io, self._fd, 0)
        # a stale descriptor makes the camera come back under another number
        with contextlib.suppress(OSError):
            self._io.close(self._fd)

    def _negotiate(self, width_px: int, height_px: int) -> v4l2.PixelFormat:
        offered = list(v4l2.formats(self._io, self._fd))
        for fourcc in _WANTED:
            if fourcc not in offered:
                continue
            got = v4l2.set_format(self._io, self._fd, fourcc, width_px, height_px)
            if got.fourcc == fourcc:
                return got
        raise CameraError(
            f"{self._what}: offers {', '.join(offered) or 'no format'}; "
            "use a camera with MJPEG or YUYV"
        )

    def _set_rate(self, rate_hz: float) -> float:
        try:
            return v4l2.set_rate(self._io, self._fd, rate_hz)
        except OSError as error:
            # a camera that has no choice of rate runs at its own
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return 0.0
            raise

    def _start(self) -> None:
        for index in range(v4l2.request_buffers(self._io, self._fd, 4)):
            self._buffers.append(v4l2.map_buffer(self._io, self._fd, index))
            v4l2.queue_buffer(self._io, self._fd, index)
        v4l2.stream(self._io, self._fd, True)
