"""Cameras of Linux: the buffer's own stamp, sequence and JPEG bytes."""

from __future__ import annotations

from device.camera import CameraSpec
from device.clock import Clock
from device.drivers.live import LiveCamera, Taken
from device.drivers.v4l2_controls import ControlKeeper
from device.drivers.v4l2_device import VideoDevice
from device.drivers.v4l2_ioctl import LinuxVideoIO, PixelFormat, VideoIO
from device.drivers.v4l2_nodes import explain, find, identity
from device.drivers.v4l2_pixels import decode


class V4l2Camera(LiveCamera):
    """spec.address: BUS_INFO, serial=..., empty, or /dev/videoN, resolved once to its bus.

    io: the operating system.
    """

    def __init__(self, spec: CameraSpec, clock: Clock, *, io: VideoIO | None = None) -> None:
        super().__init__(spec, clock)
        self._io = io or LinuxVideoIO()
        self._identity = spec.address
        self._device: VideoDevice | None = None
        self._keeper = ControlKeeper(spec.name, spec.controls)
        self._settings: dict[str, int | float | str] = {}

    @property
    def format(self) -> PixelFormat | None:
        """What the camera settled on; None while it is not connected."""
        return self._device.format if self._device else None

    @property
    def settings(self) -> dict[str, int | float | str]:
        """Format, size, rate, node and controls."""
        return self._settings | self._keeper.settings

    def _open(self) -> None:
        spec = self.spec
        node = find(self._identity, spec.eye, self._io)
        self._identity = identity(self._identity, node)
        size = spec.width_px, spec.height_px
        device = VideoDevice(self._io, node, *size, spec.rate_hz, self._keeper)
        self._device, got = device, device.format
        self._settings = {
            "name": node.card,
            "address": node.address,
            "serial": node.serial,
            "path": node.path,
            "format": got.fourcc,
            "width_px": got.width_px,
            "height_px": got.height_px,
            "rate_hz": round(device.rate_hz, 3),
        }
        if 0 < device.rate_hz < 0.99 * spec.rate_hz:
            self._remark(
                f"{spec.name}: gives {device.rate_hz:g} Hz, not {spec.rate_hz:g}, as {got.fourcc} "
                f"at {got.width_px}x{got.height_px}; a smaller size may be faster"
            )
        for remark in self._keeper.remarks:
            self._remark(remark)

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _settle(self) -> bool:
        if self._device is None or not self._keeper.pending:
            return False
        try:
            self._device.settle()
        except OSError as error:
            raise explain(self.spec.name, error) from None
        for remark in self._keeper.remarks:
            self._remark(remark)
        return True

    def _take(self, timeout_s: float) -> Taken | None:
        if self._device is None:
            return None
        try:
            filled = self._device.dequeue(timeout_s)
        except OSError as error:
            raise explain(self.spec.name, error) from None
        if filled is None:
            return None
        buffer, data = filled
        image = None if buffer.corrupt else decode(data, self._device.format)
        return Taken(buffer.sequence, buffer.t_ns, image)
