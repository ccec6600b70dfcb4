"""Findings on disk, clock, temperature, service and unfinished drives."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from calm_edge.commands.finding import Finding, bad, good, note
from calm_edge.commands.service_start import UNIT
from calm_edge.config import Config

# two cameras of 1280x720 at 20 Hz
USUAL_BYTES_A_S = 10e9 / 3600
LEAST_LEFT_S = 3600.0


def disk(config: Config, out: Path) -> Iterator[Finding]:
    """Yield the minutes that can be recorded in `out` at the rate of its newest drive."""
    from calm_edge.recording.health import Space
    from calm_edge.recording.room import measure

    if out.exists() and not out.is_dir():
        yield bad("disk", f"{out}: is a file", "choose another folder with --out")
        return
    if not out.is_dir():
        yield note("disk", f"{out}: no such folder yet; its disk was not checked")
        return
    if not os.access(out, os.W_OK):
        yield bad("disk", f"{out}: not writable", "choose another folder, or its owner")
    rate, source = _rate(out)
    free, floor = measure(out, config.recording)
    left_s = Space(free, floor, rate).left_s
    if free is None or left_s is None:
        yield note("disk", f"{out}: its free space cannot be measured")
        return
    text = f"{out}: {free / (1 << 30):.1f} GiB free, {left_s / 60:.0f} minutes left at "
    text += f"{rate / 1e6:.1f} MB/s ({source})"
    if left_s <= 0:
        yield bad("disk", text, "delete files, or lower recording.keep_free_gib")
    elif left_s < LEAST_LEFT_S:
        yield note("disk", text, "delete files; `record --root` removes the oldest drives itself")
    else:
        yield good("disk", text)


def _rate(out: Path) -> tuple[float, str]:
    """Bytes a second of the newest finished segment under `out`, and which that is."""
    from calm_edge.recording import RecordingError
    from calm_edge.recording.reader import Recording
    from calm_edge.recording.retention import drives
    from calm_edge.recording.segment import segment_files
    from device.frame import Eye

    for drive in [*reversed(drives(out)), out]:
        with suppress(RecordingError, OSError):
            for file in reversed(segment_files(drive)):
                t_ns = Recording(file).frame_times(Eye.PRIMARY)
                span_s = (int(t_ns.max()) - int(t_ns.min())) / 1e9 if len(t_ns) > 1 else 0.0
                if span_s > 1:
                    return file.stat().st_size / span_s, f"of {file}"
    return USUAL_BYTES_A_S, "usual for 1280x720 at 20 Hz"


def clock() -> Finding:
    """Whether the clock is synchronised, hence the date of a drive right."""
    from calm_edge.recording.time_base import synchronised

    if synchronised():
        return good("clock", "synchronised")
    return note(
        "clock",
        "not synchronised: the dates of drives may be wrong, poses are not affected",
        "timedatectl set-ntp true, or a GPS receiver with chrony",
    )


def heat(config: Config) -> Finding:
    """Temperature and throttling of the processor."""
    from device.thermal import ThermalReader

    thermal = ThermalReader(Path(config.degrade.thermal_root)).read()
    if thermal.celsius is None:
        return good("heat", f"no sensor in {config.degrade.thermal_root}")
    text = f"{thermal.celsius:.0f} °C, throttled" * thermal.throttled
    text = (
        text or f"{thermal.celsius:.0f} °C, work is reduced from {config.degrade.hot_c:.0f} °C on"
    )
    if thermal.throttled or thermal.celsius > config.degrade.hot_c:
        return note("heat", text, "shade or ventilate the computer")
    return good("heat", text)


@dataclass(frozen=True, slots=True)
class Service:
    """State of the service, empty values if it is not installed. status: its own line."""

    active: str = ""
    enabled: str = ""
    status: str = ""

    @property
    def installed(self) -> bool:
        """Whether systemd knows the unit."""
        return bool(self.active)


def service_state() -> Service:
    """Ask systemd for the state of the service."""
    keys = ("LoadState", "ActiveState", "UnitFileState", "StatusText")
    command = ["systemctl", "show", UNIT, *(f"--property={key}" for key in keys)]
    try:
        run = subprocess.run(command, capture_output=True, text=True, timeout=10, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return Service()
    table = dict(line.partition("=")[::2] for line in run.stdout.splitlines())
    if table.get("LoadState") != "loaded":
        return Service()
    return Service(
        table.get("ActiveState", ""), table.get("UnitFileState", ""), table.get("StatusText", "")
    )


def service(state: Service) -> Finding:
    """The service in words."""
    if not state.installed:
        return good("service", "not installed: record by hand, or install the package (deploy.md)")
    text = ", ".join(part for part in (state.active, state.enabled, state.status) if part)
    if state.active == "failed":
        return note("service", text, f"journalctl -u {UNIT} has the reason")
    if state.active != "active" or state.enabled != "enabled":
        return note("service", text, f"sudo systemctl enable --now {UNIT}")
    return good("service", text)


def unfinished(out: Path) -> Iterator[Finding]:
    """Yield drives under `out` that were not closed, and maps that were interrupted."""
    from calm_edge.recording.retention import drives
    from calm_edge.recording.segment import PART
    from device.drivers.v4l2_identity import holders

    open_drives = []
    for drive in [*drives(out), out]:
        parts = sorted(drive.glob(f"*.mcap{PART}"))
        if parts and any(holders(str(part.resolve())) for part in parts):
            yield good("drives", f"{drive} is being recorded")
        elif parts:
            open_drives.append(drive)
    for drive in open_drives:
        yield note(
            "drives",
            f"{drive} was not closed, by a power cut perhaps",
            "map, export and replay read it; `calm-edge recover` copies what is intact",
        )
    yield from events(out)
    for plan in sorted(out.glob("*/unfinished/plan.json")):
        folder = plan.parent.parent
        yield note(
            "maps", f"{folder} was interrupted", f"calm-edge map REC --out {folder} --resume"
        )
    if out.is_dir() and not open_drives:
        yield good("drives", f"{len(drives(out))} in {out}, all closed")


def events(out: Path) -> Iterator[Finding]:
    """Yield how many events were marked in the newest drive under `out` that has some."""
    from calm_edge.recording import RecordingError
    from calm_edge.recording.reader import Recording
    from calm_edge.recording.retention import drives
    from calm_edge.recording.schema import EVENT

    for drive in reversed(drives(out)):
        with suppress(RecordingError, OSError):
            if count := Recording(drive).count(EVENT):
                page = drive / "report.html"
                where = str(page) if page.exists() else f"calm-edge report {drive}"
                marked = "1 event was" if count == 1 else f"{count} events were"
                yield good("events", f"{marked} marked in {drive}: {where} lists them")
                return
