"""Video4Linux2 cameras, with the stamp, sequence number and JPEG bytes of the driver's buffers."""

from __future__ import annotations

from device.camera import CameraSpec
from device.clock import Clock
from device.drivers.live import LiveCamera, RawFrame
from device.drivers.v4l2_controls import ControlKeeper
from device.drivers.v4l2_device import VideoDevice
from device.drivers.v4l2_ioctl import LinuxVideoIO, VideoIO
from device.drivers.v4l2_nodes import explain, find, identity
from device.drivers.v4l2_pixels import decode


class V4l2Camera(LiveCamera):
    """A Video4Linux2 camera.

    spec.address: `BUS_INFO`, `serial=...`, `/dev/videoN` (replaced by its bus when opened) or
    empty, see v4l2_nodes.find. io: the system calls.
    """

    def __init__(self, spec: CameraSpec, clock: Clock, *, io: VideoIO | None = None) -> None:
        super().__init__(spec, clock)
        self._io = io or LinuxVideoIO()
        self._identity = spec.address
        self._device: VideoDevice | None = None
        self._keeper = ControlKeeper(spec.name, spec.controls)
        self._settings: dict[str, int | float | str] = {}

    @property
    def settings(self) -> dict[str, int | float | str]:
        """Device, format, size, rate and controls as read back."""
        return self._settings | self._keeper.settings | self._measured

    def _open(self) -> None:
        spec = self.spec
        node = find(self._identity, spec.eye, self._io)
        self._identity = identity(self._identity, node)
        size = spec.width_px, spec.height_px
        device = VideoDevice(self._io, node, *size, spec.rate_hz, self._keeper)
        self._device, form = device, device.format
        self._settings = {
            "name": node.card,
            "address": node.address,
            "serial": node.serial,
            "path": node.path,
            "format": form.fourcc,
            "width_px": form.width_px,
            "height_px": form.height_px,
            "rate_hz": round(device.rate_hz, 3),
        }
        if 0 < device.rate_hz < 0.99 * spec.rate_hz:
            self._remark(
                f"{spec.name}: gives {device.rate_hz:g} Hz, not {spec.rate_hz:g}, as {form.fourcc} "
                f"at {form.width_px}x{form.height_px}; a smaller size may be faster"
            )
        for remark in self._keeper.remarks:
            self._remark(remark)

    def _close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def _lock_settled(self) -> bool:
        if self._device is None or not self._keeper.pending:
            return False
        try:
            self._device.lock_settled()
        except OSError as error:
            raise explain(self.spec.name, error) from None
        for remark in self._keeper.remarks:
            self._remark(remark)
        return True

    def _read_device(self, timeout_s: float) -> RawFrame | None:
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
        return RawFrame(buffer.sequence, buffer.t_ns, image)
