"""How hot the machine is, and whether the kernel holds its processor back."""

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
    """celsius: of the hottest zone, None where none can be read; zone: its name.

    throttled: a cooling device of the processor is at work.
    """

    celsius: float | None = None
    zone: str = ""
    throttled: bool = False


class ThermalReader:
    """Reads `thermal_zone*` and `cooling_device*` under `root`; never raises."""

    def __init__(self, root: Path = SYS_THERMAL) -> None:
        self._root = root

    def read(self) -> Thermal:
        """As it is now."""
        celsius, zone = max(self._zones(), default=(None, ""))
        return Thermal(celsius, zone, any(self._throttling()))

    def _zones(self) -> Iterator[tuple[float, str]]:
        for zone in self._root.glob("thermal_zone*"):
            millidegrees = _number(zone / "temp")
            low, high = _PLAUSIBLE_C
            if millidegrees is not None and low <= millidegrees / 1000 <= high:
                yield millidegrees / 1000, _text(zone / "type") or zone.name

    def _throttling(self) -> Iterator[bool]:
        for device in self._root.glob("cooling_device*"):
            kind = _text(device / "type").lower().removeprefix("thermal-")
            # idle ones say 0 or -1; fans cool without slowing anything
            yield kind.startswith(_PROCESSOR) and (_number(device / "cur_state") or 0) > 0


class ThermalWatch:
    """Reads by a thread of its own: some sensors take many milliseconds to answer."""

    def __init__(self, reader: ThermalReader, period_s: float) -> None:
        self._reader, self._period_s = reader, period_s
        self._stopping = threading.Event()
        # replaced whole, so that whoever reads it needs no lock
        self.latest = Thermal()
        threading.Thread(target=self._run, name="thermal", daemon=True).start()

    def stop(self) -> None:
        """Ends the thread after the reading that is under way; does not wait for it."""
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
