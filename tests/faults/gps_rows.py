"""Fault rows with a GPS receiver that is unplugged, garbled or silent: recording goes on."""

from __future__ import annotations

import dataclasses
import importlib
import os
import time
from pathlib import Path
from unittest import mock

from calm_edge.daemon.hub import Hub
from calm_edge.daemon.source import of_sequence
from calm_edge.recording.reader import Recording
from device.gps import reception
from device.gps.serial_gps import SerialGps
from tests.device.gps.sentences import measurement
from tests.faults.row import AfterFrames, Row, all_frames, health, loop_figures
from tests.replay.daemon_run import record

UTC_NS = 1_700_000_000 * 10**9
KINDS = {
    "unplugged": ("lost", "cannot be opened"),
    "garbled": ("sends no NMEA",),
    "silent": ("sends nothing",),
}


class Receiver:
    """Sends a measurement with each frame once the port is open, then does what `kind` says."""

    def __init__(self, link: Path, kind: str, n: int) -> None:
        self._link, self._kind, self._good = link, kind, n // 4
        self.is_open = lambda: False
        self._main, self._port = os.openpty()
        link.symlink_to(os.ttyname(self._port))
        self.sent = 0

    def __call__(self, hub: Hub) -> None:
        if self.sent < self._good:
            if not self.is_open():
                return
            at_ns = UTC_NS + self.sent * 10**8
            os.write(self._main, measurement(at_ns, 48.0, 11.0, 500.0).encode())
            self.sent += 1
        elif self._kind == "garbled":
            os.write(self._main, os.urandom(40) + b"\n")
        elif self._kind == "unplugged":
            self.close()

    def close(self) -> None:
        for fd in (self._main, self._port):
            if fd >= 0:
                os.close(fd)
        self._main = self._port = -1
        self._link.unlink(missing_ok=True)


def faulty_gps(drive: Path, n: int, folder: Path, kind: str) -> Row:
    """Record with a receiver that fails in the middle of the drive. kind: of KINDS."""
    # takes seconds on a busy computer, and is done on opening the port
    importlib.import_module("serial")
    link = folder / "gps"
    receiver = Receiver(link, kind, n)
    source = of_sequence(drive, True)
    gps = SerialGps(str(link), 9600, source.clock.now_ns)
    receiver.is_open = lambda: gps._port.connected
    source = dataclasses.replace(source, sensors=(gps,))
    during = AfterFrames(*((k, receiver) for k in range(1, n)))
    silent_s = n / 10 / 5
    try:
        with (
            mock.patch.object(reception, "SILENT_S", silent_s),
            mock.patch("calm_edge.daemon.monitor.PERIOD_S", min(1.0, silent_s / 2)),
        ):
            result, _ = record(drive, folder / "rec", lockstep=False, source=source, during=during)
    finally:
        receiver.close()
    fixes = list(Recording(folder / "rec").fixes())
    faults = " ".join(result.losses())
    reasons = " ".join(" ".join(m["reasons"]) for m in health(folder / "rec"))
    named = any(text in faults for text in KINDS[kind])
    shown = any(text in reasons for text in KINDS[kind])
    kept = result.frames == [n, n] and result.unrecorded == 0 and all_frames(folder / "rec", n)
    return Row(
        f"GPS {kind}",
        f"{len(fixes)} of {receiver.sent} fixes recorded, {sum(result.frames)} frames, "
        f"{loop_figures(folder / 'rec')}",
        "no frame lost; the fixes before are recorded; the fault is named",
        kept and named and shown and 0 < receiver.sent - 1 <= len(fixes) <= receiver.sent,
    )


def no_receiver(drive: Path, n: int, folder: Path) -> Row:
    """Record with a receiver that is not there from start to end."""
    source = of_sequence(drive, True)
    gps = SerialGps(str(folder / "nothing"), 9600, source.clock.now_ns)
    source = dataclasses.replace(source, sensors=(gps,))
    started = time.monotonic()
    result, _ = record(drive, folder / "rec", lockstep=False, source=source)
    named = any("cannot be opened" in line for line in result.losses())
    kept = result.frames == [n, n] and all_frames(folder / "rec", n)
    return Row(
        "GPS not connected",
        f"{sum(result.frames)} frames in {time.monotonic() - started:.0f} s",
        "no frame lost; the fault is named",
        kept and named,
    )
