"""What is given up, and in which order, when the machine is hot or behind. Frames never are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

from calm_edge.config import ConfigError, DegradeConfig
from device.thermal import Thermal

# a step back up must be earned for longer than a step down, or the two would alternate
CALM_STEPS = 3


class Shed(IntEnum):
    """Each step includes those before it. Capture, recording and the tracker are not on it."""

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
    """waiting: windows the estimator has not answered. overtaken: those left to `map` so far, for
    newer ones were there already.
    """

    thermal: Thermal
    waiting: int
    overtaken: int = 0


def check(config: DegradeConfig) -> None:
    """Raises ConfigError for limits that leave no way back."""
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
    """Owner of the present step.

    Down one step each `step_s` in which it was always too hot or too far behind, up one after
    CALM_STEPS times as long in which it was always cool and caught up; between the two limits it
    stays. Being behind alone never sheds all windows: a late pose is better than none.
    depth: False leaves DEPTH out, for depth is not made anyhow.
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
        """The present step."""
        return self._steps[self._at]

    def update(self, now_s: float, load: Load) -> Shed:
        """The step from now on; `reasons` then says what presses."""
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
                # an earlier heat may have led further than the backlog of now would
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
        said = []
        if thermal.celsius is not None and thermal.celsius >= self._config.hot_c:
            said.append(f"{thermal.celsius:.0f} °C")
        if thermal.throttled:
            said.append("processor throttled")
        return tuple(said)

    def _backlog(self, now_s: float, waiting: int) -> tuple[str, ...]:
        if waiting > self._config.behind_windows:
            return (f"{waiting} windows wait",)
        # few wait, for others were given up
        late = now_s - self._overtaken_s < self._config.step_s
        return ("windows come faster than they are solved",) if late else ()

    def _cool(self, thermal: Thermal) -> bool:
        return thermal.celsius is None or thermal.celsius <= self._config.cool_c
