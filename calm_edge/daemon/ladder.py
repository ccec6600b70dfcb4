"""Load shedding when the computer is hot or behind: what is left out, and in which order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from calm_edge.config import ConfigError, DegradeConfig
from device.thermal import Thermal

# hysteresis: steps of calm before work is resumed, or shedding and resuming would alternate
CALM_STEPS = 3


class Shed(IntEnum):
    """Steps of the ladder; each includes those before it. Frames are always recorded."""

    NOTHING = 0
    DEPTH = 1
    HALF_THE_WINDOWS = 2
    ALL_WINDOWS = 3

    @property
    def words(self) -> str:
        """For the user."""
        return _WORDS[self]


_WORDS = {
    Shed.NOTHING: "nothing left out",
    Shed.DEPTH: "depth left to map",
    Shed.HALF_THE_WINDOWS: "half the keyframes left out",
    Shed.ALL_WINDOWS: "windows left to map",
}


@dataclass(frozen=True, slots=True)
class Load:
    """waiting: windows not yet processed. overtaken: how many were left to `map` so far, newer ones
    being there.
    """

    thermal: Thermal
    waiting: int
    overtaken: int = 0


def check(config: DegradeConfig) -> None:
    """Raises ConfigError for limits that would never let work resume."""
    if not config.cool_c < config.hot_c:
        raise ConfigError(
            f"degrade.cool_c = {config.cool_c:g}: must be below degrade.hot_c = {config.hot_c:g}"
        )
    if not config.step_s > 0 or config.behind_windows < 1:
        raise ConfigError(
            f"degrade.step_s = {config.step_s:g}, behind_windows = {config.behind_windows}: must "
            "be above 0"
        )


class Ladder:
    """Owner of the current step.

    One step further after each `step_s` of being constantly too hot or too far behind, one step
    back after CALM_STEPS times as long of being constantly cool and caught up; between the two
    limits it stays. A backlog alone never sheds all windows: a late pose is better than none.
    depth: False skips DEPTH, where depth is not computed anyway.
    """

    def __init__(self, config: DegradeConfig, *, depth: bool) -> None:
        self._config = config
        self._steps = [s for s in Shed if depth or s is not Shed.DEPTH]
        self._at = 0
        self._pressed_since: float | None = None
        self._calm_since: float | None = None
        self._overtaken, self._overtaken_s = 0, -math.inf
        self.reasons: tuple[str, ...] = ()

    @property
    def shed(self) -> Shed:
        """The current step."""
        return self._steps[self._at]

    def update(self, now_s: float, load: Load) -> Shed:
        """The step from now on; `reasons` then holds what is too hot or behind."""
        if load.overtaken > self._overtaken:
            self._overtaken, self._overtaken_s = load.overtaken, now_s
        hot, behind = self._heat(load.thermal), self._backlog(now_s, load.waiting)
        self.reasons = (*hot, *behind)
        if self.reasons:
            self._calm_since = None
            if self._pressed_since is None:
                self._pressed_since = now_s
            elif now_s - self._pressed_since >= self._config.step_s:
                self._pressed_since = now_s
                last = len(self._steps) - (1 if hot else 2)
                # heat may have led further before than the backlog would now
                self._at = max(self._at, min(self._at + 1, last))
        elif self._cool(load.thermal) and load.waiting <= 1:
            self._pressed_since = None
            if self._calm_since is None:
                self._calm_since = now_s
            elif now_s - self._calm_since >= CALM_STEPS * self._config.step_s:
                self._calm_since = now_s
                self._at = max(self._at - 1, 0)
        else:
            self._pressed_since = self._calm_since = None
        return self.shed

    def _heat(self, thermal: Thermal) -> tuple[str, ...]:
        reasons = []
        if thermal.celsius is not None and thermal.celsius >= self._config.hot_c:
            reasons.append(f"{thermal.celsius:.0f} °C")
        if thermal.throttled:
            reasons.append("processor throttled")
        return tuple(reasons)

    def _backlog(self, now_s: float, waiting: int) -> tuple[str, ...]:
        if waiting > self._config.behind_windows:
            return (f"{waiting} windows wait",)
        # few wait because others were left to map
        late = now_s - self._overtaken_s < self._config.step_s
        return ("windows come faster than they are solved",) if late else ()

    def _cool(self, thermal: Thermal) -> bool:
        return thermal.celsius is None or thermal.celsius <= self._config.cool_c
