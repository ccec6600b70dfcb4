"""What the system knows of a video node besides the driver: USB port, serial, who has it open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_SYS, _PROC = Path("/sys"), Path("/proc")


@dataclass(frozen=True, slots=True)
class NodeFacts:
    """serial: of the USB device, empty without one. port: the device's place in the system, which
    orders several nodes of one device whatever their numbers.
    """

    serial: str = ""
    port: str = ""


def facts(path: str, sys: Path = _SYS) -> NodeFacts:
    """Of a node by its path; all empty where the system does not tell."""
    try:
        device = (sys / "class/video4linux" / Path(path).name / "device").resolve(strict=True)
    except OSError:
        return NodeFacts()
    for folder in (device, *device.parents):
        # the first USB device above; its hub has a serial too
        if (folder / "idVendor").is_file():
            return NodeFacts(_line(folder / "serial"), str(device))
        if folder == sys:
            break
    return NodeFacts("", str(device))


def holders(path: str, proc: Path = _PROC) -> list[str]:
    """`NAME (process 123)` of each process that has the node open, as far as we may look."""
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
        # a busy process closes files while they are looked through
        return False


def _line(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""
