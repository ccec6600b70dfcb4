"""Findings on what is plugged in: cameras, the hubs they share, permissions, serial ports."""

from __future__ import annotations

import os
import pwd
import resource
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

from calm_edge.commands.finding import Finding, bad, good, note
from calm_edge.config import Config
from device.camera import FoundCamera
from device.usb_place import UsbPlace, place_of

# device nodes and the group that may use them
NODES = (("video*", "video"), ("ttyUSB*", "dialout"), ("ttyACM*", "dialout"))


def cameras(
    config: Config, found: Sequence[FoundCamera], errors: Sequence[str]
) -> Iterator[Finding]:
    """Yield a finding for each camera, for the configured ones, and for hubs that they share."""
    for line in errors:
        yield note("cameras", line)
    usable = [camera for camera in found if not camera.by_name_only]
    if not usable:
        yield note(
            "cameras",
            "none found: only replays (--sequence, --replay) can be recorded",
            "plug in two USB cameras, each at a port of its own",
        )
    places = {camera.address: place_of(camera.path) for camera in found}
    for camera in found:
        text = f"{camera.address}, {camera.name}, {camera.path}{_placed(places[camera.address])}"
        if camera.note:
            yield note("camera", text, camera.note)
        else:
            yield good("camera", text)
    if len(usable) == 1:
        yield note("cameras", "one found, two are needed", "plug in the second")
    known = {camera.address for camera in found} | {f"v4l2:{camera.path}" for camera in found}
    known |= {f"v4l2:serial={camera.serial}" for camera in found if camera.serial}
    for eye in ("primary", "assistant"):
        address = getattr(config.capture, eye)
        if address.startswith("v4l2:") and address != "v4l2:" and address not in known:
            yield bad(f"capture.{eye}", f"{address} is not plugged in", "see `calm-edge cameras`")
    yield from shared_hubs({camera.address: places[camera.address] for camera in usable})


def shared_hubs(places: dict[str, UsbPlace | None]) -> Iterator[Finding]:
    """Yield a finding for each pair of cameras at one hub or one bus."""
    placed = [(address, place) for address, place in places.items() if place is not None]
    for (a, at_a), (b, at_b) in combinations(placed, 2):
        if at_a.hub and at_a.hub == at_b.hub:
            yield note(
                "usb",
                f"{a} and {b} share the hub {at_a.hub}, so their bandwidth",
                "plug one into another port of the computer",
            )
        elif at_a.bus == at_b.bus:
            yield good("usb", f"{a} and {b} are on bus {at_a.bus}, at ports of their own")
        else:
            yield good("usb", f"{a} and {b} are on different buses")


def _placed(place: UsbPlace | None) -> str:
    if place is None:
        return ""
    hub = f" hub {place.hub}" if place.hub else ""
    return f", USB bus {place.bus}{hub}, {place.mbit_s:g} Mbit/s"


def permissions(config: Config, dev: Path = Path("/dev")) -> Iterator[Finding]:
    """Yield findings on device nodes that may not be used, and on real-time priority."""
    nodes = [(node, group) for pattern, group in NODES for node in sorted(dev.glob(pattern))]
    denied = [(n, group) for n, group in nodes if not os.access(n, os.R_OK | os.W_OK)]
    user = _user()
    for node, group in denied:
        yield note(
            "permissions",
            f"{node} may not be used by {user}",
            f"sudo usermod -aG {group} {user}, then log in again",
        )
    if nodes and not denied:
        yield good(
            "permissions", f"all {len(nodes)} cameras and serial ports may be used by {user}"
        )
    elif not nodes:
        yield good("permissions", "no camera and no serial port to try")
    wanted = config.capture.realtime_priority
    most = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if os.geteuid() and wanted > most >= 0:
        yield note(
            "priority",
            f"capture.realtime_priority = {wanted}, {user} may have {most}",
            "the service may have it; for a shell, see limits.conf(5), rtprio",
        )


def _user() -> str:
    """Name of the user, or its number if it has none."""
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def serial(config: Config) -> Finding:
    """The port that poses are sent on."""
    port = config.pose_output.port
    if not port:
        return good("serial", "pose_output.port is empty: poses are not sent")
    if port.startswith("udp:"):
        return good("serial", f"poses are sent to {port}")
    return _device("serial", port, config.pose_output.baud, "no poses are sent")


def gps(config: Config) -> Finding:
    """The receiver whose fixes are recorded."""
    source = config.gps.source
    if not source:
        return good("gps", "gps.source is empty: no fixes are recorded")
    if source.partition(":")[0] == "gpsd":
        return good("gps", f"fixes are asked of {source}")
    return _device("gps", source, config.gps.baud, "no fixes are recorded")


def _device(name: str, port: str, baud: int, cost: str) -> Finding:
    """A serial device. cost: what is missed without it."""
    if not Path(port).exists():
        remedy = "plug it in, or choose another: ls /dev/calm-edge /dev/ttyUSB*"
        return note(name, f"{port} is not there: {cost}", remedy)
    if not os.access(port, os.R_OK | os.W_OK):
        remedy = "add the user to the group dialout and log in again"
        return note(name, f"{port}: permission denied: {cost}", remedy)
    return good(name, f"{port} at {baud} baud")
