"""OAK cameras by depthai v3: JPEG from the device, stamps on the host's clock.

Written against the library alone: what a host can run of a pipeline is tested, a device never was.
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
from device.drivers.live import LiveCamera, Taken
from device.drivers.oak_rig import Factory, Pipeline, Queue, Wanted, shared
from device.errors import CameraError
from device.frame import Eye

_JPEG_START = b"\xff\xd8"
_QUALITY = 92
_QUEUE = 8
# an older stamp was made before the device had learned the host's clock
_OLDEST_NS = 10 * NS_PER_S
_ABSENT = "no OAK device found; plug one in (USB 3), see deploy/99-calm-edge.rules for access"


def load() -> Any:
    """depthai, without telemetry and without its own signal handlers; raises CameraError."""
    # read by the library as it is loaded
    os.environ["DEPTHAI_TELEMETRY"] = "0"
    os.environ["DEPTHAI_INSTALL_SIGNAL_HANDLER"] = "0"
    os.environ.setdefault("DEPTHAI_LEVEL", "error")
    try:
        import depthai
    except ImportError:
        raise CameraError("OAK cameras need depthai, which is not installed (make setup)") from None
    return depthai


def present(dai: Any, device: str = "") -> Any:
    """depthai's DeviceInfo of a device by id, of the first if empty; raises CameraError."""
    found = dai.Device.getAllAvailableDevices()
    for info in found:
        if device in ("", info.getDeviceId(), info.name):
            return info
    if not found:
        raise CameraError(_ABSENT)
    known = ", ".join(info.getDeviceId() for info in found)
    raise CameraError(f"OAK device {device}: not there; found: {known}")


def discover(details: bool = True) -> list[FoundCamera]:
    """A line a device that is plugged in; sockets show only once it runs. Raises CameraError."""
    return [
        FoundCamera(f"oak:{info.getDeviceId()}", "OAK device", info.name, info.getDeviceId())
        for info in load().Device.getAllAvailableDevices()
    ]


class DevicePipeline:
    """Camera and JPEG encoder of each socket on a device; raises CameraError."""

    def __init__(self, dai: Any, device: Any, pipeline: Any, wanted: Sequence[Wanted]) -> None:
        self._dai, self._owner, self._pipeline = dai, device, pipeline
        self.device: str = device.getDeviceId()
        self.queues: Mapping[str, Queue] = {}
        self._inputs: dict[str, Any] = {}
        queues = {}
        for each in wanted:
            socket = getattr(dai.CameraBoardSocket, each.socket)
            camera = pipeline.create(dai.node.Camera).build(socket, sensorFps=each.rate_hz)
            command(dai, camera.initialControl, each.controls)
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
        command(self._dai, message, controls)
        self._inputs[socket].send(message)

    def close(self) -> None:
        self._pipeline.stop()
        self._owner.close()


def on_device(device: str, wanted: Sequence[Wanted]) -> Pipeline:
    """The real thing: a pipeline on a device. Raises CameraError."""
    dai = load()
    info = present(dai, device)
    try:
        opened = dai.Device(info)
        # we rebuild by ourselves: a device that reconnects alone counts its frames anew, unsaid
        opened.setMaxReconnectionAttempts(0)
        return DevicePipeline(dai, opened, dai.Pipeline(opened), wanted)
    except RuntimeError as error:
        raise CameraError(f"OAK device {info.getDeviceId()}: {error}") from None


def command(dai: Any, message: Any, controls: CameraControls) -> None:
    """Numbers, and a focus that is not to move, as depthai's CameraControl says them."""
    if isinstance(controls.exposure_us, int) and isinstance(controls.gain, int):
        message.setManualExposure(controls.exposure_us, controls.gain)
    if isinstance(controls.white_balance_k, int):
        message.setManualWhiteBalance(controls.white_balance_k)
    if isinstance(controls.focus, int):
        message.setManualFocus(controls.focus)
    elif controls.focus == LOCK:
        message.setAutoFocusMode(dai.CameraControl.AutoFocusMode.OFF)


class OakCamera(LiveCamera):
    """spec.address: `ID/SOCKET`, as in `14442C10D13EABCE00/CAM_B`; with `/raw` behind it pictures
    come uncompressed. `ID` alone: its CAM_A. Empty: the first device, CAM_B for the primary and
    CAM_C for the assistant. Both eyes may be on one device.

    factory: makes the pipeline of a device.
    """

    def __init__(self, spec: CameraSpec, clock: Clock, *, factory: Factory = on_device) -> None:
        super().__init__(spec, clock)
        device, socket, raw = parse(spec)
        if isinstance(spec.controls.exposure_us, int) != isinstance(spec.controls.gain, int):
            raise CameraError(
                f"{spec.name}: exposure_us and gain (ISO) are set together: give both as numbers"
            )
        size = spec.width_px, spec.height_px
        self._wanted = Wanted(socket, *size, spec.rate_hz, raw, spec.controls)
        self._rig = shared(device, factory)
        self._rig.join(self._wanted)
        self._pipeline: Pipeline | None = None
        self._newest: Any = None

    @property
    def settings(self) -> dict[str, int | float | str]:
        """Device and format; of exposure, gain, white balance and lens what is held, as the newest
        frame tells it.
        """
        if self._pipeline is None:
            return {}
        asked = self._wanted
        told: dict[str, int | float | str] = {
            "address": f"{self._pipeline.device}/{asked.socket}",
            "format": "NV12" if asked.raw else "MJPG",
            "width_px": asked.width_px,
            "height_px": asked.height_px,
            "rate_hz": asked.rate_hz,
        }
        found = {} if self._newest is None else read_back(self._newest)
        wanted = dataclasses.asdict(asked.controls)
        moving = AUTO, AUTO_THEN_LOCK
        return told | {k: AUTO if wanted[k] in moving else v for k, v in found.items()}

    def _open(self) -> None:
        try:
            self._pipeline = self._rig.enter(self._wanted.socket)
        except CameraError as error:
            raise CameraError(f"{self.spec.name}: {error}") from None

    def _close(self) -> None:
        pipeline, self._pipeline = self._pipeline, None
        if not self._running:
            self._rig.leave(self._wanted.socket)
        elif pipeline is not None:
            self._rig.lost(pipeline)

    def _settle(self) -> bool:
        """What was found is held as numbers, so that a rebuilt pipeline begins with them."""
        wanted, found = dataclasses.asdict(self._wanted.controls), self._newest
        pending = {k for k, v in wanted.items() if v in (LOCK, AUTO_THEN_LOCK)}
        if not pending or found is None or self._pipeline is None:
            return False
        # the sensor takes the two only together
        if pending & {"exposure_us", "gain"}:
            pending |= {"exposure_us", "gain"}
        held = {k: v for k, v in read_back(found).items() if k in pending and v}
        controls = CameraControls(**(wanted | held))
        self._wanted = dataclasses.replace(self._wanted, controls=controls)
        self._rig.join(self._wanted)
        self._pipeline.control(self._wanted.socket, controls)
        return bool(held)

    def _take(self, timeout_s: float) -> Taken | None:
        if self._pipeline is None:
            return None
        try:
            queue = self._pipeline.queues[self._wanted.socket]
            message = queue.get(timedelta(seconds=timeout_s))
        except Exception as error:
            # depthai's own kinds derive from nothing closer
            raise CameraError(f"{self.spec.name}: lost ({error})") from None
        if message is None:
            if not self._pipeline.alive():
                raise CameraError(f"{self.spec.name}: lost")
            return None
        self._newest = message
        t_ns = message.getTimestamp() // timedelta(microseconds=1) * 1000
        usable = t_ns > 0 and self._clock.now_ns() - t_ns < _OLDEST_NS
        return Taken(message.getSequenceNum(), t_ns if usable else None, picture(message))


def parse(spec: CameraSpec) -> tuple[str, str, bool]:
    """Device, socket and whether pictures are raw, of a spec's address; raises CameraError."""
    parts = spec.address.split("/") if spec.address else []
    raw = len(parts) > 1 and parts[-1] == "raw"
    device, *rest = parts[:-1] if raw else parts or [""]
    default = "CAM_A" if device else ("CAM_B", "CAM_C")[spec.eye is Eye.ASSISTANT]
    socket = rest[0] if rest else default
    if len(rest) > 1 or not (len(socket) == 5 and socket[:4] == "CAM_" and socket[4] in "ABCDEFGH"):
        raise CameraError(f"{spec.name}: expected oak:ID/CAM_A to CAM_H, with /raw or without")
    return device, socket, raw


def read_back(message: Any) -> dict[str, int]:
    """What the sensor did for one frame."""
    return {
        "exposure_us": message.getExposureTime() // timedelta(microseconds=1),
        "gain": message.getSensitivity(),
        "white_balance_k": message.getColorTemperature(),
        "focus": message.getLensPosition(),
    }


def picture(message: Any) -> NDArray[np.uint8] | bytes | None:
    """An encoded frame's bytes as they are, another's pixels as BGR; None if it is neither."""
    if not hasattr(message, "getCvFrame"):
        data = bytes(message.getData())
        return data if data.startswith(_JPEG_START) else None
    pixels = np.asarray(message.getCvFrame(), np.uint8)
    if pixels.ndim == 2:
        pixels = np.asarray(cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR), np.uint8)
    return pixels
