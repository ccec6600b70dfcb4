"""USB port and serial number of a video node, and the processes that have it open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_SYS, _PROC = Path("/sys"), Path("/proc")


@dataclass(frozen=True, slots=True)
class NodeFacts:
    """serial: of the USB device, or empty. port: path of the device in sysfs.

    Sorting by port orders the nodes of one device independently of their numbers.
    """

    serial: str = ""
    port: str = ""


def facts(path: str, sys: Path = _SYS) -> NodeFacts:
    """Return the facts of a node such as `/dev/video0`; empty fields if sysfs has no entry."""
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
    """`NAME (process 123)` for each process that has the node open and may be inspected."""
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
        # the process closed the file meanwhile
        return False


def _line(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""
