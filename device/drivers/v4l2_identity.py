"""USB port and serial number of a video node, and the processes that have it open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_SYS, _PROC = Path("/sys"), Path("/proc")


@dataclass(frozen=True, slots=True)
class NodeFacts:
    """Serial number and port of a video node.

    serial: of the USB device, or empty. port: path of the device in sysfs; sorted by it, the nodes
    of one device keep their order when node numbers change.
    """

    serial: str = ""
    port: str = ""


def facts(path: str, sys: Path = _SYS) -> NodeFacts:
    """Read serial and port of a node such as `/dev/video0`; empty if sysfs has no entry."""
    try:
        device = (sys / "class/video4linux" / Path(path).name / "device").resolve(strict=True)
    except OSError:
        return NodeFacts()
    for folder in (device, *device.parents):
        # stop at the first USB device above: the hub behind it has a serial too
        if (folder / "idVendor").is_file():
            return NodeFacts(_line(folder / "serial"), str(device))
        if folder == sys:
            break
    return NodeFacts("", str(device))


def holders(path: str, proc: Path = _PROC) -> list[str]:
    """List the processes that have the node open, as `NAME (process 123)`.

    Processes that may not be inspected are left out.
    """
    found = []
    for process in sorted(proc.glob("[0-9]*"), key=lambda p: p.name):
        try:
            links = list((process / "fd").iterdir())
        except OSError:
            # another user's process, or one that has just ended
            continue
        if any(_points_at(link, path) for link in links):
            found.append(f"{_line(process / 'comm') or 'a program'} (process {process.name})")
    return found


def _points_at(link: Path, path: str) -> bool:
    try:
        return str(link.readlink()) == path
    except OSError:
        # the process has closed the file since it was listed
        return False


def _line(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""
