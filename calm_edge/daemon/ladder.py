"""Load shedding in steps when the computer is too hot or the estimator too slow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from calm_edge.config import ConfigError, DegradeConfig
from device.thermal import Thermal

# hysteresis: work is left out after `step_s` of overload, resumed after this many `step_s` without
CALM_STEPS = 3


class Shed(IntEnum):
    """Work that is left out; each step includes those before it. Frames are always recorded."""

    NOTHING = 0
    DEPTH = 1
    HALF_THE_WINDOWS = 2
    ALL_WINDOWS = 3

    @property
    def words(self) -> str:
        """Description for the user."""
        return _WORDS[self]


_WORDS = {
    Shed.NOTHING: "nothing left out",
    Shed.DEPTH: "depth left for calm-edge map",
    Shed.HALF_THE_WINDOWS: "half the keyframes left out",
    Shed.ALL_WINDOWS: "windows left for calm-edge map",
}


@dataclass(frozen=True, slots=True)
class Load:
    """Load of the computer.

    waiting: number of windows not yet processed by the estimator. overtaken: number of windows
    that the estimator has skipped since the start, to process newer ones.
    """

    thermal: Thermal
    waiting: int
    overtaken: int = 0


def check(config: DegradeConfig) -> None:
    """Check the limits; raises ConfigError for those with which work would never be resumed."""
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
    """Controller of load shedding: leaves out or resumes the work of one step at a time.

    After each `step_s` during which the computer was too hot or too many windows waited, work of
    one more step is left out; after each CALM_STEPS * `step_s` during which it was cool and at
    most one window waited, work of one step is resumed. Waiting windows alone never lead to the
    last step: without windows there are no live poses. depth: False if no depth is computed anyway.
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
        """Current step."""
        return self._steps[self._at]

    def update(self, now_s: float, load: Load) -> Shed:
        """Return the step from now on; sets `reasons`, texts of what is too hot or too slow."""
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
                # max: waiting windows alone do not lead to the last step, but keep it if heat did
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
            return (f"{waiting} windows wait to be solved",)
        # if windows were skipped recently, a short queue does not mean that the estimator keeps up
        late = now_s - self._overtaken_s < self._config.step_s
        return ("windows come faster than they are solved",) if late else ()

    def _cool(self, thermal: Thermal) -> bool:
        return thermal.celsius is None or thermal.celsius <= self._config.cool_c
