"""Temperature of the computer and thermal throttling of its processor, from sysfs."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SYS_THERMAL = Path("/sys/class/thermal")
# zones without a sensor behind them report zero, absolute zero or hundreds of degrees
_PLAUSIBLE_C = (1.0, 150.0)
_PROCESSOR = ("processor", "cpufreq", "cpu")


@dataclass(frozen=True, slots=True)
class Thermal:
    """Temperature and throttling of the computer.

    celsius: temperature of the hottest zone, None if none can be read. throttled: True if
    a cooling device of the processor is active.
    """

    celsius: float | None = None
    throttled: bool = False


class ThermalReader:
    """Reader of `thermal_zone*` and `cooling_device*` under `root`; never raises."""

    def __init__(self, root: Path = SYS_THERMAL) -> None:
        self._root = root

    def read(self) -> Thermal:
        """Read all zones and cooling devices once."""
        return Thermal(max(self._zones(), default=None), any(self._throttling()))

    def _zones(self) -> Iterator[float]:
        for zone in self._root.glob("thermal_zone*"):
            millidegrees = _number(zone / "temp")
            low, high = _PLAUSIBLE_C
            if millidegrees is not None and low <= millidegrees / 1000 <= high:
                yield millidegrees / 1000

    def _throttling(self) -> Iterator[bool]:
        for device in self._root.glob("cooling_device*"):
            kind = _text(device / "type").lower().removeprefix("thermal-")
            # an idle device reports 0 or -1; fans do not slow the processor and are left out
            yield kind.startswith(_PROCESSOR) and (_number(device / "cur_state") or 0) > 0


class ThermalWatch:
    """Read the temperature periodically in a thread: some sensors take many milliseconds.

    latest: the last reading.
    """

    def __init__(self, reader: ThermalReader, period_s: float) -> None:
        self._reader, self._period_s = reader, period_s
        self._stopping = threading.Event()
        # immutable and replaced by each reading, so that other threads need no lock
        self.latest = Thermal()
        threading.Thread(target=self._run, name="thermal", daemon=True).start()

    def stop(self) -> None:
        """Stop the thread after the current reading, without waiting for it."""
        self._stopping.set()

    def _run(self) -> None:
        while not self._stopping.is_set():
            self.latest = self._reader.read()
            self._stopping.wait(self._period_s)


def _text(path: Path) -> str:
    try:
        return path.read_text(errors="replace").strip()
    except OSError:
        return ""


def _number(path: Path) -> int | None:
    try:
        return int(_text(path))
    except ValueError:
        return None
