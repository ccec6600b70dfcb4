"""An open and streaming V4L2 video node."""

from __future__ import annotations

import contextlib
import errno
import mmap

from device.drivers import v4l2_ioctl as v4l2
from device.drivers.v4l2_controls import ControlKeeper
from device.drivers.v4l2_modes import choose_rate, rates
from device.drivers.v4l2_nodes import VideoNode, explain
from device.drivers.v4l2_pixels import WANTED
from device.errors import CameraError

_BUFFERS = 4


class VideoDevice:
    """Open a video node, negotiate format and rate, and start streaming into mapped buffers.

    Opening raises CameraError; the methods raise OSError if the device is lost. keeper: sets the
    controls before the first image; None leaves them unchanged.
    """

    def __init__(
        self,
        io: v4l2.VideoIO,
        node: VideoNode,
        width_px: int,
        height_px: int,
        rate_hz: float,
        keeper: ControlKeeper | None = None,
    ) -> None:
        self._io = io
        self._what = f"camera {node.address} ({node.path})"
        self._keeper = keeper
        self._buffers: list[mmap.mmap | bytearray] = []
        self._open = False
        try:
            self._fd = io.open(node.path)
            self._open = True
            self.format = self._negotiate(width_px, height_px)
            self.offered_hz = rates(io, self._fd, self.format, rate_hz)
            self.rate_hz = self._set_rate(choose_rate(self.offered_hz, rate_hz))
            if keeper is not None:
                keeper.apply(io, self._fd)
            self._start()
        except OSError as error:
            self.close()
            raise explain(self._what, error, io.holders(node.path)) from None
        except CameraError:
            self.close()
            raise

    def dequeue(self, timeout_s: float) -> tuple[v4l2.Buffer, bytes] | None:
        """Return the next filled buffer and a copy of its bytes; None after timeout_s."""
        if not self._io.wait(self._fd, timeout_s):
            return None
        try:
            buffer = v4l2.dequeue_buffer(self._io, self._fd)
        except BlockingIOError:
            return None
        data = bytes(self._buffers[buffer.index][: buffer.bytes_used])
        v4l2.queue_buffer(self._io, self._fd, buffer.index)
        return buffer, data

    def lock_settled(self) -> None:
        """Lock the `auto-then-lock` controls at their current values."""
        if self._keeper is not None:
            self._keeper.lock_settled(self._io, self._fd)

    def close(self) -> None:
        """Stop streaming and close the node; errors of a lost device are ignored."""
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
        # while the descriptor stays open, a reconnected camera gets another node number
        with contextlib.suppress(OSError):
            self._io.close(self._fd)

    def _negotiate(self, width_px: int, height_px: int) -> v4l2.PixelFormat:
        offered = list(v4l2.formats(self._io, self._fd))
        for fourcc in WANTED:
            if fourcc not in offered:
                continue
            form = v4l2.set_format(self._io, self._fd, fourcc, width_px, height_px)
            if form.fourcc == fourcc:
                return form
        raise CameraError(
            f"{self._what}: no supported format among {', '.join(offered) or 'none'}; "
            f"use a camera with one of {', '.join(WANTED)}"
        )

    def _set_rate(self, rate_hz: float) -> float:
        try:
            return v4l2.set_rate(self._io, self._fd, rate_hz)
        except OSError as error:
            # these errors: the camera has a fixed rate
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return 0.0
            raise

    def _start(self) -> None:
        for index in range(v4l2.request_buffers(self._io, self._fd, _BUFFERS)):
            self._buffers.append(v4l2.map_buffer(self._io, self._fd, index))
            v4l2.queue_buffer(self._io, self._fd, index)
        v4l2.stream(self._io, self._fd, True)
