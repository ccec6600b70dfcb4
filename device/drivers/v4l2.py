"""Cameras of Linux: the buffer's own stamp, sequence and JPEG bytes, and a way back when lost."""

from __future__ import annotations

import errno
import logging
import math

import cv2
import numpy as np
from numpy.typing import NDArray

from device.camera import CameraSpec, CameraStats
from device.clock import NS_PER_S, Clock
from device.drivers.v4l2_device import VideoDevice, explain, find
from device.drivers.v4l2_ioctl import Buffer, LinuxVideoIO, PixelFormat, VideoIO
from device.errors import CameraError
from device.frame import Frame
from device.stream import Stream

log = logging.getLogger(__name__)

_RETRY_NS = NS_PER_S
_JPEG_START = b"\xff\xd8"


class V4l2Camera:
    """spec.address: BUS_INFO, /dev/videoN (resolved once, at start, to its bus), or empty.

    clock: CLOCK_MONOTONIC, which the kernel stamps with. io: the operating system.
    """

    exhausted = False

    def __init__(self, spec: CameraSpec, clock: Clock, *, io: VideoIO | None = None) -> None:
        self.spec = spec
        self._clock = clock
        self._io = io or LinuxVideoIO()
        self._identity = ""
        self._device: VideoDevice | None = None
        self._running = False
        self._retry_ns = 0
        self._sequence_offset = 0
        self._needs_offset = False
        self._stream = Stream()

    @property
    def connected(self) -> bool:
        """False before start, while the camera is unplugged, and after stop."""
        return self._device is not None

    @property
    def format(self) -> PixelFormat | None:
        """What the camera settled on; None while it is not connected."""
        return self._device.format if self._device else None

    def start(self) -> None:
        """Finds the camera, opens it and starts the stream; raises CameraError."""
        if self._running:
            return
        self._identity = find(self._identity or self.spec.address, self.spec.eye, self._io).address
        self._open()
        self._running = True

    def read(self, timeout_s: float) -> Frame | None:
        """The next frame; while the camera is gone it is looked for by identity each second."""
        limit_ns = self._clock.now_ns() + math.floor(timeout_s * NS_PER_S)
        while self._running:
            left_ns = max(0, limit_ns - self._clock.now_ns())
            if self._device is None:
                self._wait_for_return(limit_ns)
            else:
                frame = self._read_once(self._device, left_ns / NS_PER_S)
                if frame is not None:
                    return frame
            if self._clock.now_ns() >= limit_ns:
                return None
        return None

    def latest(self, max_age_ns: int) -> Frame | None:
        """The newest frame in the driver's buffers, or the last one read while it is fresh."""
        while self.read(0.0) is not None:
            pass
        return self._stream.fresh(self._clock.now_ns(), max_age_ns) if self._running else None

    def stop(self) -> None:
        """Stops the stream and closes the node."""
        self._running = False
        self._close()

    def stats(self) -> CameraStats:
        """The counts so far."""
        return self._stream.stats

    def _open(self) -> None:
        spec = self.spec
        node = find(self._identity, spec.eye, self._io)
        self._device = VideoDevice(self._io, node, spec.width_px, spec.height_px, spec.rate_hz)
        self._needs_offset = True
        got = self._device.format
        log.info(
            "%s: %s at %s, %s %dx%d, %g Hz",
            spec.name,
            node.card,
            node.path,
            got.fourcc,
            got.width_px,
            got.height_px,
            self._device.rate_hz,
        )

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _wait_for_return(self, limit_ns: int) -> None:
        self._clock.sleep_until_ns(min(limit_ns, self._retry_ns))
        if self._clock.now_ns() < self._retry_ns:
            return
        try:
            self._open()
        except CameraError as error:
            log.debug("%s", error)
            self._retry_ns = self._clock.now_ns() + _RETRY_NS
            return
        self._stream.count("reconnects")
        log.info("%s: is back", self.spec.name)

    def _read_once(self, device: VideoDevice, timeout_s: float) -> Frame | None:
        try:
            filled = device.dequeue(timeout_s)
        except OSError as error:
            kind = "unplugged" if error.errno == errno.ENODEV else "failed"
            log.warning("%s; %s, looking for it every second", explain(self.spec.name, error), kind)
            self._close()
            self._retry_ns = self._clock.now_ns() + _RETRY_NS
            return None
        if filled is None:
            return None
        buffer, data = filled
        now_ns = self._clock.now_ns()
        image = None if buffer.corrupt else _image(data, device.format)
        if image is None:
            self._stream.count("corrupt")
            return None
        if buffer.t_ns is None:
            self._stream.count("host_stamped")
        t_ns = now_ns if buffer.t_ns is None else buffer.t_ns
        frame = Frame(self.spec.eye, self._sequence(buffer), t_ns, image)
        return self._stream.admit(frame, now_ns)

    def _sequence(self, buffer: Buffer) -> int:
        """Counts on after a reconnect, where the driver begins at 0 again."""
        if self._needs_offset:
            newest = self._stream.newest
            self._sequence_offset = newest.sequence + 1 - buffer.sequence if newest else 0
            self._needs_offset = False
        return buffer.sequence + self._sequence_offset


def _image(data: bytes, form: PixelFormat) -> NDArray[np.uint8] | bytes | None:
    """The bytes of a JPEG, or YUYV converted to (H, W, 3) BGR; None if they are not one."""
    if form.fourcc != "YUYV":
        return data if data.startswith(_JPEG_START) else None
    stride = form.stride_bytes or 2 * form.width_px
    if len(data) < stride * form.height_px:
        return None
    rows = np.frombuffer(data, np.uint8, stride * form.height_px).reshape(form.height_px, stride)
    pairs = np.ascontiguousarray(rows[:, : 2 * form.width_px])
    yuyv = pairs.reshape(form.height_px, form.width_px, 2)
    return np.asarray(cv2.cvtColor(yuyv, cv2.COLOR_YUV2BGR_YUYV), np.uint8)
