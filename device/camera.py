"""Interface of camera drivers, and their registry by name."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, cast

from device.clock import Clock
from device.errors import CameraError
from device.frame import Eye, Frame

AUTO, AUTO_THEN_LOCK, LOCK = "auto", "auto-then-lock", "lock"


@dataclass(frozen=True, slots=True)
class CameraControls:
    """Requested mode or value of each automatic camera control.

    `auto`: the camera adjusts it. `auto-then-lock`: adjusted for two seconds, then locked. `lock`:
    locked at its value when the camera is opened. A number is set and locked: exposure_us in
    microseconds, gain in the driver's unit (ISO for OAK), white_balance_k in kelvin, focus in the
    driver's unit. Locked values are restored after a reconnect. Raises CameraError for any other
    word.
    """

    exposure_us: int | str = AUTO
    gain: int | str = AUTO
    white_balance_k: int | str = AUTO
    focus: int | str = LOCK

    def __post_init__(self) -> None:
        words = (AUTO, AUTO_THEN_LOCK, LOCK)
        for key in dataclasses.fields(self):
            value = getattr(self, key.name)
            if isinstance(value, str) and value not in words:
                raise CameraError(
                    f"capture.{key.name} = {value!r}: expected a whole number or "
                    f"one of {', '.join(words)}"
                )


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """Device, eye and requested image mode of one camera.

    address: in the syntax of the driver. width_px, height_px, rate_hz: requests; the camera may
    choose its nearest mode.
    """

    eye: Eye
    driver: str
    address: str = ""
    width_px: int = 1280
    height_px: int = 720
    rate_hz: float = 10.0
    controls: CameraControls = CameraControls()

    @property
    def name(self) -> str:
        """Name of the camera in messages, such as `primary camera v4l2:usb-1`."""
        return f"{self.eye.name.lower()} camera {self.driver}:{self.address}"


@dataclass(frozen=True, slots=True)
class CameraStats:
    """Counters of one camera since start().

    frames: frames delivered. drops: gaps in the sequence numbers. clamped: stamps corrected because
    they were in the future or not after the preceding one. reconnects: how often the lost camera
    was reopened. host_stamped: frames stamped on arrival, having no usable device stamp. corrupt:
    buffers that could not be used.
    """

    frames: int = 0
    drops: int = 0
    clamped: int = 0
    reconnects: int = 0
    host_stamped: int = 0
    corrupt: int = 0


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that is plugged in.

    address: `driver:address`, as in the config key `capture.primary`. path: its current device
    node. formats: format -> sizes and rates; controls: name -> value and range; both empty unless
    details were requested. note: why it cannot be used at present, else empty. by_name_only: never
    chosen unless its address is given.
    """

    address: str
    name: str
    path: str
    serial: str = ""
    formats: Mapping[str, Sequence[str]] = field(default_factory=dict)
    controls: Mapping[str, str] = field(default_factory=dict)
    note: str = ""
    by_name_only: bool = False


SAME_DEVICE = (
    "is used for both cameras; give capture.primary and capture.assistant different addresses, "
    "as listed by calm-edge cameras"
)


class Camera(Protocol):
    """Interface of a camera, a source of frames; read() and stop() are called by one thread."""

    spec: CameraSpec

    def start(self) -> None:
        """Open the camera; raises CameraError. Does nothing if already started."""
        ...

    def read(self, timeout_s: float) -> Frame | None:
        """Return the next frame, or None if there is none within timeout_s or after stop().

        Stamps strictly increase. An unplugged camera yields None until it is found again.
        """
        ...

    def stop(self) -> None:
        """Close the camera; may be called repeatedly, and before start()."""
        ...

    def stats(self) -> CameraStats:
        """Return the counters."""
        ...

    @property
    def settings(self) -> Mapping[str, int | float | str]:
        """Format, size, rate and controls as read back from the camera.

        Empty before start() and for a replay.
        """
        ...

    @property
    def remarks(self) -> Sequence[str]:
        """Requested settings that the camera did not apply, one line each, without duplicates."""
        ...

    @property
    def connected(self) -> bool:
        """True while the camera is open; False while it is unplugged or not started."""
        ...

    @property
    def exhausted(self) -> bool:
        """True once a replay has ended; always False for a live camera."""
        ...


DRIVERS: dict[str, tuple[str, str]] = {
    "oak": ("device.drivers.oak", "OakCamera"),
    "replay": ("device.drivers.replay", "ReplayCamera"),
    "v4l2": ("device.drivers.v4l2", "V4l2Camera"),
}

# driver -> function that lists its cameras; a replay has no devices to list
DISCOVERERS: dict[str, tuple[str, str]] = {
    "v4l2": ("device.drivers.v4l2_nodes", "discover"),
    "oak": ("device.drivers.oak", "discover"),
}


def parse_address(text: str) -> tuple[str, str]:
    """Split `driver:address`; raises CameraError for an unknown driver."""
    driver, _, address = text.partition(":")
    if driver not in DRIVERS:
        raise CameraError(f"camera {text!r}: unknown driver {driver!r}; use one of {_known()}")
    return driver, address


def open_camera(spec: CameraSpec, clock: Clock, **options: Any) -> Camera:
    """Create the camera described by a spec without starting it; raises CameraError.

    options: passed to the driver's constructor.
    """
    if spec.driver not in DRIVERS:
        raise CameraError(f"{spec.name}: unknown driver {spec.driver!r}; use one of {_known()}")
    module, name = DRIVERS[spec.driver]
    return cast(Camera, getattr(importlib.import_module(module), name)(spec, clock, **options))


def refuse_same_device(cameras: Sequence[Camera]) -> None:
    """Raise CameraError if two started cameras are one device, opened twice."""
    seen: set[tuple[str, object]] = set()
    for camera in cameras:
        address = camera.settings.get("address")
        if address and (camera.spec.driver, address) in seen:
            raise CameraError(f"{camera.spec.name}: {SAME_DEVICE}")
        seen.add((camera.spec.driver, address))


def discover(details: bool = True) -> tuple[list[FoundCamera], list[str]]:
    """Return the cameras of every driver, and one error line for each driver that failed.

    details: list formats and controls too, which takes longer and opens each camera.
    """
    found: list[FoundCamera] = []
    errors: list[str] = []
    for module, name in DISCOVERERS.values():
        try:
            found += getattr(importlib.import_module(module), name)(details=details)
        except CameraError as error:
            errors.append(str(error))
    return found, errors


def _known() -> str:
    return ", ".join(sorted(DRIVERS))
