"""Choices of `calm-edge setup`: which cameras, which is the primary, spacing, serial ports.

What the terminal and the page have in common; nothing here asks, shows or opens a device.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from calm_edge.commands.config_file import write_keys
from calm_edge.commands.configuration import SPACING_M, check
from calm_edge.commands.length_text import metres_of
from calm_edge.config import CaptureConfig, Config, merge
from device.camera import FoundCamera
from device.errors import CameraError

WHAT_TO_PLUG_IN = (
    "Plug in two USB cameras (UVC), each at a port of the computer itself, not both at one hub. "
    "Fix them so that both see the road and much of the same scene."
)
NONE = "none"


class Choices:
    """Changes to a configuration. base: that of the file, or the defaults.

    pair: the cameras found, primary first; empty if they are known by address alone or stand-ins.
    """

    def __init__(self, base: Config) -> None:
        self.base = base
        self.pair: list[FoundCamera] = []
        self._changes: dict[str, dict[str, Any]] = {}

    @property
    def config(self) -> Config:
        """The base with the changes."""
        return merge(self.base, self._changes)

    @property
    def has_cameras(self) -> bool:
        """Whether two cameras were chosen."""
        return "capture" in self._changes

    def take(self, pair: Sequence[FoundCamera]) -> None:
        """Choose two cameras, primary first."""
        self.pair = list(pair)
        self.take_addresses(*(camera.address for camera in pair))

    def take_addresses(self, primary: str, assistant: str) -> None:
        """Choose two cameras by their addresses."""
        self._changes["capture"] = {"primary": primary, "assistant": assistant}

    def swap(self) -> None:
        """Make the assistant the primary."""
        capture = self.config.capture
        if self.pair:
            self.take(self.pair[::-1])
        else:
            self.take_addresses(capture.assistant, capture.primary)

    def set_spacing(self, spacing_m: float) -> None:
        """Choose the distance of the lenses [m]; 0: unknown."""
        self._changes["scale"] = {"spacing_m": spacing_m}

    def set_ports(self, port: str, receiver: str) -> None:
        """Choose where poses are sent, and the GPS receiver; NONE: neither."""
        self._changes["pose_output"] = {"port": "" if port == NONE else port}
        self._changes["gps"] = {"source": "" if receiver == NONE else receiver}

    def new_keys(self, path: Path) -> dict[str, dict[str, Any]]:
        """What has to change in the file at `path`, by section and key.

        Cameras get a kit file beside it, if they have none. Raises ConfigError for values that
        cannot be meant.
        """
        changes = dict(self._changes)
        if self.has_cameras and not self.base.backbone.kit_file:
            changes["backbone"] = {"kit_file": str(path.with_suffix(".json").absolute())}
        check(merge(self.base, changes))
        before = self.base.to_dict()
        new = {}
        for section, values in changes.items():
            differing = {k: v for k, v in values.items() if v != before[section][k]}
            if differing:
                new[section] = differing
        return new

    def write(self, path: Path) -> None:
        """Write what has changed to a file, which keeps all else. Raises ConfigError."""
        new = self.new_keys(path)
        write_keys(path, new)
        self.base = merge(self.base, new)


def usable(found: Sequence[FoundCamera]) -> list[FoundCamera]:
    """Cameras that may be chosen, by address."""
    return sorted((c for c in found if not c.by_name_only), key=lambda c: c.address)


def proposed(cameras: Sequence[FoundCamera], capture: CaptureConfig) -> list[FoundCamera]:
    """Two of at least two cameras, primary first: those configured before, else the first ones."""
    known = {camera.address: camera for camera in cameras}
    before = [known[a] for a in (capture.primary, capture.assistant) if a in known]
    return before if len(before) == 2 else list(cameras[:2])


def arranged(
    pair: Sequence[FoundCamera],
    cameras: Sequence[FoundCamera],
    primary: str | None,
    assistant: str | None,
) -> list[FoundCamera]:
    """The pair, with the cameras of given addresses at their places; raises CameraError."""
    if primary and assistant:
        return [_plugged_in(cameras, address) for address in (primary, assistant)]
    new = list(pair)
    for eye, address in enumerate((primary, assistant)):
        if address and _plugged_in(cameras, address) != new[eye]:
            # the one that was chosen for the other eye takes its place
            new[1 - eye] = new[eye]
            new[eye] = _plugged_in(cameras, address)
    return new


def _plugged_in(cameras: Sequence[FoundCamera], address: str) -> FoundCamera:
    for camera in cameras:
        if camera.address == address:
            return camera
    raise CameraError(f"{address}: not plugged in; see `calm-edge cameras`")


def two_of(cameras: Sequence[FoundCamera], text: str) -> list[FoundCamera]:
    """Cameras of two numbers, from 1; raises ValueError with what is wrong."""
    numbers = text.split()
    valid: Mapping[str, FoundCamera] = {str(k): camera for k, camera in enumerate(cameras, 1)}
    if len(numbers) != 2 or len({*numbers}) != 2 or not {*numbers} <= {*valid}:
        raise ValueError("give two of the numbers, such as 1 2")
    return [valid[number] for number in numbers]


def spacing_of(text: str) -> float:
    """Metres of a length, 0 for NONE; raises ValueError with what is wrong."""
    if text == NONE:
        return 0.0
    metres = metres_of(text)
    if not SPACING_M[0] <= metres <= SPACING_M[1]:
        raise ValueError(f"{metres:g} m: {SPACING_M[0]:g} to {SPACING_M[1]:g} m can be meant")
    return metres


def serial_devices(dev: Path = Path("/dev")) -> list[str]:
    """Serial devices that are plugged in."""
    patterns = ("calm-edge/serial-*", "ttyUSB*", "ttyACM*")
    return sorted(str(path) for pattern in patterns for path in dev.glob(pattern))
