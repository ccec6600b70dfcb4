"""The contract of every camera driver, and the table that finds one by name."""

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
    """What a camera may change by itself, each a number or a word.

    `auto`: the camera's business. `auto-then-lock`: so for two seconds, then held. `lock`: held as
    it stands when the camera is opened. A number is set and held: exposure_us in microseconds, gain
    in the driver's unit (ISO for OAK), white_balance_k in kelvin, focus in the driver's unit.
    A lost camera comes back with what it was held at. Raises CameraError for another word.
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
                    f"capture.{key.name} = {value!r}: a whole number or one of {', '.join(words)}"
                )


@dataclass(frozen=True, slots=True)
class CameraSpec:
    """Which camera is which eye, and what is asked of it.

    address: the driver's own way to name a device. width_px, height_px, rate_hz are requests:
    the camera may settle on its nearest. stale_after_ms: silence after which it is stale.
    """

    eye: Eye
    driver: str
    address: str = ""
    width_px: int = 1280
    height_px: int = 720
    rate_hz: float = 10.0
    stale_after_ms: float = 500.0
    controls: CameraControls = CameraControls()

    @property
    def name(self) -> str:
        """How messages name it: `primary camera v4l2:usb-1`."""
        return f"{self.eye.name.lower()} camera {self.driver}:{self.address}"


@dataclass(frozen=True, slots=True)
class CameraStats:
    """Counts since start().

    frames: handed over. drops: missing by their sequence number. clamped: stamps moved, being
    in the future or not after their predecessor. reconnects: times a lost camera came back.
    host_stamped: stamped when read, for want of a usable device stamp. corrupt: unusable buffers.
    """

    frames: int = 0
    drops: int = 0
    clamped: int = 0
    reconnects: int = 0
    host_stamped: int = 0
    corrupt: int = 0


@dataclass(frozen=True, slots=True)
class FoundCamera:
    """A camera that is there. address: as written into `capture.primary`. path: its place just
    now. formats: format -> sizes and rates; controls: name -> value and range; both empty where
    they were not asked for. note: why it cannot be used just now.
    """

    address: str
    name: str
    path: str
    serial: str = ""
    formats: Mapping[str, Sequence[str]] = field(default_factory=dict)
    controls: Mapping[str, str] = field(default_factory=dict)
    note: str = ""


class Camera(Protocol):
    """A source of frames, read and stopped by one thread."""

    spec: CameraSpec

    def start(self) -> None:
        """Opens the camera; raises CameraError. A second start is no change."""
        ...

    def read(self, timeout_s: float) -> Frame | None:
        """The next frame in order, stamps strictly increasing; None after timeout_s without one.

        A camera that was unplugged gives None and is looked for again; after stop() None.
        """
        ...

    def latest(self, max_age_ns: int) -> Frame | None:
        """The newest frame there is, passing over older ones; None if older than max_age_ns."""
        ...

    def stop(self) -> None:
        """Closes the camera; may be called again, and before start()."""
        ...

    def stats(self) -> CameraStats:
        """The counts so far."""
        ...

    @property
    def settings(self) -> Mapping[str, int | float | str]:
        """What the camera settled on, read back: format, size, rate, controls; empty before
        start(), and of a replay.
        """
        ...

    @property
    def remarks(self) -> Sequence[str]:
        """What the camera does not do as asked, a line each; grows, and no line comes twice."""
        ...

    @property
    def connected(self) -> bool:
        """False while the device is gone."""
        ...

    @property
    def exhausted(self) -> bool:
        """True when no frame will ever come again: a replay that ended. Never, of a live one."""
        ...


DRIVERS: dict[str, tuple[str, str]] = {
    "oak": ("device.drivers.oak", "OakCamera"),
    "replay": ("device.drivers.replay", "ReplayCamera"),
    "v4l2": ("device.drivers.v4l2", "V4l2Camera"),
}

# driver -> what lists its cameras; a replay has none to list
DISCOVERERS: dict[str, tuple[str, str]] = {
    "v4l2": ("device.drivers.v4l2_nodes", "discover"),
    "oak": ("device.drivers.oak", "discover"),
}


def parse_address(text: str) -> tuple[str, str]:
    """`driver:address` -> (driver, address); raises CameraError for an unknown driver."""
    driver, _, address = text.partition(":")
    if driver not in DRIVERS:
        raise CameraError(f"camera {text!r}: unknown driver {driver!r}; known: {_known()}")
    return driver, address


def open_camera(spec: CameraSpec, clock: Clock, **options: Any) -> Camera:
    """The camera of a spec, not yet started; options go to its driver. Raises CameraError."""
    if spec.driver not in DRIVERS:
        raise CameraError(f"{spec.name}: unknown driver {spec.driver!r}; known: {_known()}")
    module, name = DRIVERS[spec.driver]
    return cast(Camera, getattr(importlib.import_module(module), name)(spec, clock, **options))


def discover(details: bool = True) -> tuple[list[FoundCamera], list[str]]:
    """Every camera of every driver, and a line for each driver that could not look.

    details: formats and controls too, which takes longer and opens each camera.
    """
    found: list[FoundCamera] = []
    troubles: list[str] = []
    for module, name in DISCOVERERS.values():
        try:
            found += getattr(importlib.import_module(module), name)(details=details)
        except CameraError as error:
            troubles.append(str(error))
    return found, troubles


def _known() -> str:
    return ", ".join(sorted(DRIVERS))
