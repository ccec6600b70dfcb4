"""Where a USB device is plugged in: bus, hub and speed, from sysfs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

# BUS-PORT, and .PORT for each hub on the way
_DEVICE = re.compile(r"(\d+)-[\d.]+")


@dataclass(frozen=True, slots=True)
class UsbPlace:
    """Place of a USB device.

    bus: number of its controller's bus. hub: name of the hub it is plugged into, such as `1-1`;
    empty if it is plugged into the computer. mbit_s: speed of its connection, 0 if unknown.
    """

    bus: int
    hub: str
    mbit_s: float


def place_of(node: str, sys: Path = Path("/sys")) -> UsbPlace | None:
    """Place of a video node such as `/dev/video0`; None if it is not on USB."""
    try:
        device = (sys / "class/video4linux" / Path(node).name / "device").resolve(strict=True)
    except OSError:
        return None
    for folder in (device, *device.parents):
        found = _DEVICE.fullmatch(folder.name)
        if found and (folder / "idVendor").is_file():
            hub = folder.name.rpartition(".")[0]
            return UsbPlace(int(found[1]), hub, _number(folder / "speed"))
    return None


def _number(path: Path) -> float:
    try:
        return float(path.read_text())
    except (OSError, ValueError):
        return 0.0
