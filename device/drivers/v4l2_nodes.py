"""List the V4L2 cameras, and find one by USB port or serial number (node numbers may change)."""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from device.camera import SAME_DEVICE, FoundCamera
from device.drivers import v4l2_ioctl as v4l2
from device.drivers.v4l2_controls import get_control, list_controls
from device.drivers.v4l2_modes import list_modes, sizes
from device.errors import CameraError
from device.frame import Eye

_DENIED = (
    "permission denied; add the user to the group video and log in again, "
    "or install deploy/99-calm-edge.rules"
)
_REMEDIES = {
    errno.EACCES: _DENIED,
    errno.EPERM: _DENIED,
    errno.EBUSY: "in use by another program; close it",
    errno.ENODEV: "unplugged",
    errno.ENOSPC: (
        "no USB bandwidth left for it; plug the cameras into different USB controllers, "
        "or lower capture.width_px, capture.height_px or capture.rate_hz"
    ),
}
SERIAL = "serial="
MULTIPLANAR = (
    "has only multi-planar buffers, which are not supported; use a USB camera, "
    "or copy its images to a v4l2loopback device"
)
AUXILIARY = "a second sensor of the camera above, such as infrared; used only if named"


def explain(what: str, error: OSError, holders: Sequence[str] = ()) -> CameraError:
    """Convert an OSError of a camera to a CameraError, with a remedy for the common errors.

    what: name of the camera. holders: processes that have the device open, named if the error is
    EBUSY.
    """
    if error.errno == errno.EBUSY and any(f"(process {os.getpid()})" in each for each in holders):
        return CameraError(f"{what}: {SAME_DEVICE}")
    if error.errno == errno.EBUSY and holders:
        return CameraError(f"{what}: in use by {', '.join(holders)}; close it")
    return CameraError(f"{what}: {_REMEDIES.get(error.errno or 0, error.strerror or str(error))}")


@dataclass(frozen=True, slots=True)
class VideoNode:
    """A video node that delivers images. serial: of the USB device, or empty.

    address: its permanent identity, `BUS_INFO`, or `BUS_INFO#1` for the second such node on the
    same bus. auxiliary: not the first node of its device and of other formats or sizes, such as the
    infrared sensor of a webcam. multiplanar: it cannot be read.
    """

    path: str
    card: str
    driver: str
    address: str
    serial: str = ""
    auxiliary: bool = False
    multiplanar: bool = False


def list_devices(io: v4l2.VideoIO | None = None) -> list[VideoNode]:
    """List the cameras that can be opened, by node number.

    Raises CameraError if no camera can be opened for lack of permission.
    """
    io = io or v4l2.LinuxVideoIO()
    found: list[tuple[str, int, str, v4l2.Capability, str]] = []
    denied: CameraError | None = None
    for number, path in enumerate(io.nodes()):
        try:
            fd = io.open(path)
            try:
                capability = v4l2.query_capability(io, fd)
            finally:
                io.close(fd)
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EPERM):
                denied = explain(path, error)
            continue
        if capability.captures or capability.multiplanar:
            facts = io.facts(path)
            found.append((facts.port, number, path, capability, facts.serial))
    if denied is not None and not found:
        raise denied
    nodes: dict[int, VideoNode] = {}
    on_bus: Counter[str] = Counter()
    first: dict[str, str] = {}
    # sorted by port: two sensors of one device keep their order when nodes are renumbered
    for _, number, path, capability, serial in sorted(found, key=lambda f: f[:2]):
        nth = on_bus[capability.bus_info]
        on_bus[capability.bus_info] += 1
        address = capability.bus_info + (f"#{nth}" if nth else "")
        first.setdefault(capability.bus_info, path)
        auxiliary = nth > 0 and _modes(io, path) != _modes(io, first[capability.bus_info])
        nodes[number] = VideoNode(
            path, capability.card, capability.driver, address, serial,
            auxiliary, capability.multiplanar,
        )  # fmt: skip
    return [nodes[number] for number in sorted(nodes)]


def _modes(io: v4l2.VideoIO, path: str) -> set[tuple[str, tuple[int, int]]]:
    """Formats and sizes of a node; empty if it cannot be asked."""
    try:
        fd = io.open(path)
    except OSError:
        return set()
    try:
        return {(fourcc, size) for fourcc in v4l2.formats(io, fd) for size in sizes(io, fd, fourcc)}
    except OSError:
        return set()
    finally:
        io.close(fd)


def find(address: str, eye: Eye, io: v4l2.VideoIO) -> VideoNode:
    """Find the node of an address: a bus, `serial=...` or /dev/videoN; raises CameraError.

    If the address is empty, the cameras are sorted by bus: the first is the primary, the second the
    assistant; auxiliary nodes are left out.
    """
    nodes = list_devices(io)
    name = f"{eye.name.lower()} camera v4l2:{address}"
    known = ", ".join(map(_described, nodes)) or "no camera at all"
    if not address:
        usable = [node for node in nodes if not (node.auxiliary or node.multiplanar)]
        ordered = sorted(usable, key=lambda node: node.address)
        if len(ordered) > eye:
            return ordered[eye]
        raise CameraError(f"{name}: {len(usable)} found ({known}); plug in camera {eye + 1}")
    if address.startswith(SERIAL):
        same = [node for node in nodes if node.serial and address == SERIAL + node.serial]
        if len(same) > 1:
            raise CameraError(
                f"{name}: {len(same)} cameras have this serial; use the addresses of their ports: "
                + ", ".join(node.address for node in same)
            )
        if same:
            return same[0]
    for node in nodes:
        if address in (node.address, node.path):
            if node.multiplanar:
                raise CameraError(f"{name}: {node.path} {MULTIPLANAR}")
            return node
    raise CameraError(f"{name}: not found; plugged in: {known}")


def _described(node: VideoNode) -> str:
    if node.multiplanar:
        return f"{node.address} {MULTIPLANAR}"
    return (
        f"{node.address} (a second sensor of it, such as infrared)"
        if node.auxiliary
        else (node.address)
    )


def identity(address: str, node: VideoNode) -> str:
    """Address by which to find a lost camera again: the serial if it was given, else the bus."""
    return address if address.startswith(SERIAL) else node.address


def discover(io: v4l2.VideoIO | None = None, details: bool = True) -> list[FoundCamera]:
    """List all V4L2 cameras. details: with formats and controls, which opens each camera."""
    io = io or v4l2.LinuxVideoIO()
    found = []
    for node in list_devices(io):
        formats: dict[str, list[str]] = {}
        controls: dict[str, str] = {}
        note = MULTIPLANAR if node.multiplanar else AUXILIARY if node.auxiliary else ""
        if details and not node.multiplanar:
            try:
                formats, controls = _details(io, node.path)
            except OSError as error:
                note = str(explain(node.path, error, io.holders(node.path)))
        found.append(
            FoundCamera(f"v4l2:{node.address}", node.card, node.path, node.serial,
                        formats, controls, note, node.auxiliary or node.multiplanar)
        )  # fmt: skip
    return found


def _details(io: v4l2.VideoIO, path: str) -> tuple[dict[str, list[str]], dict[str, str]]:
    fd = io.open(path)
    try:
        formats: dict[str, list[str]] = {}
        for mode in list_modes(io, fd):
            rate = f" {max(mode.rates_hz):g} Hz" if mode.rates_hz else ""
            size = f"{mode.width_px}x{mode.height_px}{rate}"
            formats.setdefault(mode.fourcc, []).append(size)
        controls = {}
        for control in list_controls(io, fd):
            value = get_control(io, fd, control.id)
            if value is not None:
                controls[control.name] = f"{value} ({control.minimum} to {control.maximum})"
        return formats, controls
    finally:
        io.close(fd)
