"""The contract of every camera driver, and the table that finds one by name."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, Protocol, cast

from device.clock import Clock
from device.errors import CameraError
from device.frame import Eye, Frame


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
    def connected(self) -> bool:
        """False while the device is gone."""
        ...

    @property
    def exhausted(self) -> bool:
        """True when no frame will ever come again: a replay that ended. Never, of a live one."""
        ...


DRIVERS: dict[str, tuple[str, str]] = {
    "replay": ("device.drivers.replay", "ReplayCamera"),
    "v4l2": ("device.drivers.v4l2", "V4l2Camera"),
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


def _known() -> str:
    return ", ".join(sorted(DRIVERS))
