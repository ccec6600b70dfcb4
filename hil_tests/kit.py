"""The kit under test: two cameras as configured, or a folder replayed in their place."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from calm_edge.config import Config
from calm_edge.daemon.source import Source, live, of_sequence
from device.errors import DeviceError
from device.watching import Seen, collect, running


@dataclass(frozen=True, slots=True)
class Kit:
    """config_file: of the kit, None for defaults. sequence: a folder in place of cameras.

    out: where tests may write. minutes: of the soak.
    """

    config: Config
    config_file: Path | None
    sequence: Path | None
    out: Path
    minutes: float = 10.0

    def source(self) -> Source:
        """Open the source of its frames; raises CameraError, SequenceError."""
        if self.sequence is None:
            return live(self.config)
        return of_sequence(self.sequence, True)

    def absent(self) -> str:
        """Return why there are not two cameras to test, in words; empty when there are."""
        if self.sequence is not None:
            return ""
        from device.drivers.v4l2_nodes import list_devices

        drivers = {
            text.partition(":")[0]
            for text in (self.config.capture.primary, self.config.capture.assistant)
        }
        if drivers != {"v4l2"}:
            return ""
        try:
            found = len(list_devices())
        except DeviceError as error:
            return str(error)
        return "" if found >= 2 else f"{found} V4L2 cameras on this machine, two are needed"

    def record_command(self, out: Path) -> list[str]:
        """Return the command line that records this kit into a new folder."""
        command = [sys.executable, "-m", "calm_edge.cli", "record", "--out", str(out)]
        if self.config_file is not None:
            command += ["--config", str(self.config_file)]
        if self.sequence is not None:
            command += ["--sequence", str(self.sequence)]
        return command


def watch(
    kit: Kit, duration_s: float, sleep: Callable[[float], None] = time.sleep
) -> tuple[Seen, ...]:
    """Collect the frames of both eyes for a while, without their pictures; raises CameraError."""
    source = kit.source()
    with running(source.open()) as both:
        collect(both, source.clock, duration_s, sleep=sleep)
    return both
