"""What the page of `calm-edge setup` shows: the stage in a sentence, and the choices so far."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from pathlib import Path
from typing import Any

from calm_edge.commands import service_start, setup_choices
from calm_edge.commands.config_text import toml
from calm_edge.commands.finding import Finding, Level
from calm_edge.commands.plugged_in import gps, serial
from calm_edge.commands.setup_choices import WHAT_TO_PLUG_IN, Choices
from calm_edge.config import ConfigError
from calm_edge.live.sentence import BAD, GOOD, WARNING
from device.camera import FoundCamera

_LEVELS = {Level.GOOD: GOOD, Level.NOTE: WARNING, Level.BAD: BAD}


class Stage(Enum):
    """What is going on."""

    BEGINNING = auto()
    FEW = auto()
    FAULT = auto()
    OPENING = auto()
    SETTLING = auto()
    JUDGED = auto()
    COVERING = auto()
    COVERED = auto()
    MEASURING = auto()
    STARTING = auto()
    ENDED = auto()


# level and sentence; {} is a text that the state has or makes
_SENTENCES = {
    Stage.BEGINNING: (WARNING, "Looking for cameras."),
    Stage.FEW: (BAD, "{} of 2 cameras found. " + WHAT_TO_PLUG_IN),
    Stage.FAULT: (BAD, "{}"),
    Stage.OPENING: (WARNING, "Opening {} ..."),
    Stage.SETTLING: (WARNING, "Exposure and focus settle; the checks follow in a few seconds."),
    Stage.COVERING: (WARNING, "Cover the lens of the primary closely with your hand."),
    Stage.COVERED: (GOOD, "The primary is {}. Uncover its lens."),
    Stage.MEASURING: (
        WARNING,
        "Solving three windows of a rendered drive: half a minute or more. The cameras are off "
        "meanwhile.",
    ),
    Stage.STARTING: (WARNING, "Starting the service."),
}
_BUSY = Stage.COVERING, Stage.MEASURING, Stage.STARTING


@dataclass(slots=True)
class SetupState:
    """State of a set-up. path: of the file to write. startable: it is that of the service.

    notice: why the last request was not met. lights: the newest traffic lights of the cameras.
    """

    path: Path
    startable: bool
    stage: Stage = Stage.BEGINNING
    text: str = ""
    notice: str = ""
    cameras: Sequence[FoundCamera] = ()
    lights: Sequence[Finding] = ()
    speed: Finding | None = None
    written: bool = False
    started: bool = False
    _devices: list[str] = field(default_factory=setup_choices.serial_devices)

    def content(self, choices: Choices) -> dict[str, Any]:
        """The state for the page, as JSON can hold it."""
        level, sentence = self._sentence(choices)
        config = choices.config
        objection, keys = "", []
        try:
            for section, values in choices.new_keys(self.path).items():
                keys += [f"{section}.{key} = {toml(value)}" for key, value in values.items()]
        except ConfigError as error:
            objection = str(error)
        return {
            "level": level,
            "sentence": sentence,
            "notice": self.notice,
            "ended": self.stage is Stage.ENDED,
            "busy": self.stage in _BUSY,
            "cameras": [
                {"address": c.address, "name": f"{c.name}, {c.path}"} for c in self.cameras
            ],
            "chosen": choices.has_cameras,
            "primary": config.capture.primary,
            "assistant": config.capture.assistant,
            "lights": [_light(finding) for finding in self.lights],
            "spacing_m": config.scale.spacing_m,
            "port": config.pose_output.port,
            "gps": config.gps.source,
            "devices": self._devices,
            "ports": [_light(serial(config)), _light(gps(config))],
            "speed": _light(self.speed) if self.speed else None,
            "path": str(self.path),
            "keys": keys,
            "objection": objection,
            "written": self.written,
            "startable": self.startable,
            "record": service_start.record_command(self.path),
        }

    def _sentence(self, choices: Choices) -> tuple[str, str]:
        if self.stage is Stage.JUDGED:
            return judgement(self.lights)
        if self.stage is Stage.ENDED:
            return self._end()
        text = self.text
        if self.stage is Stage.FEW:
            text = str(len(self.cameras))
        elif self.stage is Stage.COVERED:
            text = choices.config.capture.primary
        level, sentence = _SENTENCES[self.stage]
        return level, sentence.format(text)

    def _end(self) -> tuple[str, str]:
        if not self.written:
            return BAD, "The set-up has ended; nothing was written."
        then = "The service records." if self.started else ""
        if not then and self.startable:
            then = f"To start the service: {service_start.BY_HAND}"
        then = then or f"To record: {service_start.record_command(self.path)}"
        return GOOD, f"{self.path} is written. {then}"


def judgement(lights: Sequence[Finding]) -> tuple[str, str]:
    """Level and sentence of traffic lights: the worst, and how many."""
    bad = [finding.name for finding in lights if finding.level is Level.BAD]
    notes = [finding.name for finding in lights if finding.level is Level.NOTE]
    if bad:
        return BAD, f"This does not work yet: {', '.join(bad)}."
    if notes:
        return WARNING, f"This works, with a consequence: {', '.join(notes)}."
    return GOOD, "Both cameras are fine."


def _light(finding: Finding) -> dict[str, str]:
    return {
        "level": _LEVELS[finding.level],
        "name": finding.name,
        "text": finding.text,
        "remedy": finding.remedy,
    }
