"""OAK cameras by depthai v3: JPEG encoded on the device, stamps on the host's clock.

Not yet tested with a device, only with the parts of depthai that run without one.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from device.camera import AUTO, AUTO_THEN_LOCK, LOCK, CameraControls, CameraSpec, FoundCamera
from device.clock import NS_PER_S, Clock
from device.drivers.live import LiveCamera, RawFrame
from device.drivers.oak_pipeline import Factory, Pipeline, Queue, SocketRequest, shared_pipeline
from device.errors import CameraError
from device.frame import Eye
from device.jpeg import completed

_QUALITY = 92
_QUEUE = 8
# an older stamp was taken before the device synchronised its clock to the host's
_OLDEST_NS = 10 * NS_PER_S
_ABSENT = "no OAK device found; plug one in (USB 3), see deploy/99-calm-edge.rules for access"


def load() -> Any:
    """Import depthai without telemetry or signal handlers; raises CameraError if not installed."""
    # depthai reads these variables when it is imported
    os.environ["DEPTHAI_TELEMETRY"] = "0"
    os.environ["DEPTHAI_INSTALL_SIGNAL_HANDLER"] = "0"
    os.environ.setdefault("DEPTHAI_LEVEL", "error")
    try:
        import depthai
    except ImportError:
        raise CameraError(
            "OAK cameras need depthai: install the package calm-edge-oak, or make setup EXTRAS=oak"
        ) from None
    return depthai


def find_device(dai: Any, device: str = "") -> Any:
    """Return the depthai.DeviceInfo of a device id, or of the first device; raises CameraError."""
    found = dai.Device.getAllAvailableDevices()
    for info in found:
        if device in ("", info.getDeviceId(), info.name):
            return info
    if not found:
        raise CameraError(_ABSENT)
    known = ", ".join(info.getDeviceId() for info in found)
    raise CameraError(f"OAK device {device}: not found; plugged in: {known}")


def discover(details: bool = True) -> list[FoundCamera]:
    """List the devices plugged in; their sockets are not listed. Raises CameraError."""
    return [
        FoundCamera(f"oak:{info.getDeviceId()}", "OAK device", info.name, info.getDeviceId())
        for info in load().Device.getAllAvailableDevices()
    ]


class DevicePipeline:
    """A running depthai pipeline: for each socket a camera node and, unless raw, a JPEG encoder."""

    def __init__(
        self, dai: Any, device: Any, pipeline: Any, requests: Sequence[SocketRequest]
    ) -> None:
        self._dai, self._owner, self._pipeline = dai, device, pipeline
        self.device: str = device.getDeviceId()
        self.queues: Mapping[str, Queue] = {}
        self._inputs: dict[str, Any] = {}
        queues = {}
        for each in requests:
            socket = getattr(dai.CameraBoardSocket, each.socket)
            camera = pipeline.create(dai.node.Camera).build(socket, sensorFps=each.rate_hz)
            write_controls(dai, camera.initialControl, each.controls)
            size = each.width_px, each.height_px
            out = camera.requestOutput(size, type=dai.ImgFrame.Type.NV12, fps=each.rate_hz)
            if not each.raw:
                encoder = pipeline.create(dai.node.VideoEncoder)
                profile = dai.VideoEncoderProperties.Profile.MJPEG
                encoder.build(out, frameRate=each.rate_hz, profile=profile, quality=_QUALITY)
                out = encoder.out
            queues[each.socket] = out.createOutputQueue(maxSize=_QUEUE, blocking=False)
            self._inputs[each.socket] = camera.inputControl.createInputQueue()
        self.queues = queues
        pipeline.start()

    def alive(self) -> bool:
        return bool(self._pipeline.isRunning()) and not self._owner.isClosed()

    def control(self, socket: str, controls: CameraControls) -> None:
        message = self._dai.CameraControl()
        write_controls(self._dai, message, controls)
        self._inputs[socket].send(message)

    def close(self) -> None:
        self._pipeline.stop()
        self._owner.close()


def on_device(device: str, requests: Sequence[SocketRequest]) -> Pipeline:
    """Open a device and start its pipeline; raises CameraError."""
    dai = load()
    info = find_device(dai, device)
    try:
        opened = dai.Device(info)
        # LiveCamera reconnects: depthai would restart the frame counter without notice
        opened.setMaxReconnectionAttempts(0)
        return DevicePipeline(dai, opened, dai.Pipeline(opened), requests)
    except RuntimeError as error:
        raise CameraError(f"OAK device {info.getDeviceId()}: {error}") from None


def write_controls(dai: Any, message: Any, controls: CameraControls) -> None:
    """Write the numeric controls and a locked focus into a depthai.CameraControl message."""
    if isinstance(controls.exposure_us, int) and isinstance(controls.gain, int):
        message.setManualExposure(controls.exposure_us, controls.gain)
    if isinstance(controls.white_balance_k, int):
        message.setManualWhiteBalance(controls.white_balance_k)
    if isinstance(controls.focus, int):
        message.setManualFocus(controls.focus)
    elif controls.focus == LOCK:
        message.setAutoFocusMode(dai.CameraControl.AutoFocusMode.OFF)


class OakCamera(LiveCamera):
    """Camera on one socket of an OAK device; both cameras may be on the same device.

    spec.address: `ID/SOCKET`, such as `14442C10D13EABCE00/CAM_B`, with `/raw` appended for
    uncompressed images. `ID` alone: its CAM_A. Empty: CAM_B (primary) and CAM_C (assistant) of the
    first device. factory: function that creates the pipeline of a device.
    """

    def __init__(self, spec: CameraSpec, clock: Clock, *, factory: Factory = on_device) -> None:
        super().__init__(spec, clock)
        device, socket, raw = parse(spec)
        if isinstance(spec.controls.exposure_us, int) != isinstance(spec.controls.gain, int):
            raise CameraError(
                f"{spec.name}: exposure_us and gain (ISO) are set together: give both as numbers"
            )
        size = spec.width_px, spec.height_px
        self._request = SocketRequest(socket, *size, spec.rate_hz, raw, spec.controls)
        self._shared = shared_pipeline(device, factory)
        self._shared.register(self._request)
        self._pipeline: Pipeline | None = None
        self._newest: Any = None

    @property
    def settings(self) -> dict[str, int | float | str]:
        """Device, image mode, and for each control `auto` or its value in the newest frame."""
        if self._pipeline is None:
            return {}
        request = self._request
        mode: dict[str, int | float | str] = {
            "address": f"{self._pipeline.device}/{request.socket}",
            "format": "NV12" if request.raw else "MJPG",
            "width_px": request.width_px,
            "height_px": request.height_px,
            "rate_hz": request.rate_hz,
        }
        values = {} if self._newest is None else control_values(self._newest)
        requested = dataclasses.asdict(request.controls)
        automatic = AUTO, AUTO_THEN_LOCK
        controls = {k: AUTO if requested[k] in automatic else v for k, v in values.items()}
        return mode | controls | self._measured

    def _open(self) -> None:
        try:
            self._pipeline = self._shared.acquire(self._request.socket)
        except CameraError as error:
            raise CameraError(f"{self.spec.name}: {error}") from None

    def _close(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if not self._running:
            self._shared.release(self._request.socket)
        elif pipeline is not None:
            self._shared.discard(pipeline)

    def _lock_settled(self) -> bool:
        """Lock the `lock` and `auto-then-lock` controls at the values of the newest frame.

        The values are kept when the pipeline is rebuilt. Returns False if there is nothing to lock.
        """
        requested, newest = dataclasses.asdict(self._request.controls), self._newest
        pending = {k for k, v in requested.items() if v in (LOCK, AUTO_THEN_LOCK)}
        if not pending or newest is None or self._pipeline is None:
            return False
        # the sensor accepts exposure and gain only together
        if pending & {"exposure_us", "gain"}:
            pending |= {"exposure_us", "gain"}
        locked = {k: v for k, v in control_values(newest).items() if k in pending and v}
        controls = CameraControls(**(requested | locked))
        self._request = dataclasses.replace(self._request, controls=controls)
        self._shared.register(self._request)
        self._pipeline.control(self._request.socket, controls)
        return bool(locked)

    def _read_device(self, timeout_s: float) -> RawFrame | None:
        if self._pipeline is None:
            return None
        try:
            queue = self._pipeline.queues[self._request.socket]
            message = queue.get(timedelta(seconds=timeout_s))
        except Exception as error:
            # depthai's exceptions have no common base class but Exception
            raise CameraError(f"{self.spec.name}: connection lost ({error})") from None
        if message is None:
            if not self._pipeline.alive():
                raise CameraError(f"{self.spec.name}: connection lost")
            return None
        self._newest = message
        t_ns = message.getTimestamp() // timedelta(microseconds=1) * 1000
        usable = t_ns > 0 and self._clock.now_ns() - t_ns < _OLDEST_NS
        return RawFrame(message.getSequenceNum(), t_ns if usable else None, image_of(message))


def parse(spec: CameraSpec) -> tuple[str, str, bool]:
    """Parse spec.address to (device id, socket, uncompressed?); raises CameraError."""
    parts = spec.address.split("/") if spec.address else []
    raw = len(parts) > 1 and parts[-1] == "raw"
    device, *rest = parts[:-1] if raw else parts or [""]
    default = "CAM_A" if device else ("CAM_B", "CAM_C")[spec.eye is Eye.ASSISTANT]
    socket = rest[0] if rest else default
    if len(rest) > 1 or not (len(socket) == 5 and socket[:4] == "CAM_" and socket[4] in "ABCDEFGH"):
        raise CameraError(f"{spec.name}: expected oak:ID/CAM_A to CAM_H, with or without /raw")
    return device, socket, raw


def control_values(message: Any) -> dict[str, int]:
    """Return the control values with which a frame was taken, by key of CameraControls."""
    return {
        "exposure_us": message.getExposureTime() // timedelta(microseconds=1),
        "gain": message.getSensitivity(),
        "white_balance_k": message.getColorTemperature(),
        "focus": message.getLensPosition(),
    }


def image_of(message: Any) -> NDArray[np.uint8] | bytes | None:
    """Return the JPEG bytes of a message, or (H, W, 3) BGR if raw; None for invalid JPEG."""
    if not hasattr(message, "getCvFrame"):
        return completed(bytes(message.getData()))
    pixels = np.asarray(message.getCvFrame(), np.uint8)
    if pixels.ndim == 2:
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR), np.uint8)
    return pixels
