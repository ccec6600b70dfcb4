"""Findings of `doctor` and `setup`: a line each, with a traffic light and the remedy."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TextIO

from calm_edge.commands.console import is_coloured


class Level(StrEnum):
    """GOOD: as it should be. NOTE: works, with a consequence. BAD: does not work."""

    GOOD = "ok"
    NOTE = "note"
    BAD = "fail"


# green, yellow, red
_COLOURS = {Level.GOOD: "\x1b[32m", Level.NOTE: "\x1b[33m", Level.BAD: "\x1b[31m"}
_RESET = "\x1b[0m"


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found of one thing. remedy: what to do, empty if there is nothing to do."""

    level: Level
    name: str
    text: str
    remedy: str = ""

    def line(self, *, coloured: bool = False) -> str:
        """The finding on one line."""
        word = f"{self.level:5}"
        if coloured:
            word = f"{_COLOURS[self.level]}{word}{_RESET}"
        return f"{word} {self.name}: {self.text}" + (f"; {self.remedy}" if self.remedy else "")


def good(name: str, text: str) -> Finding:
    """A finding that needs no remedy."""
    return Finding(Level.GOOD, name, text)


def note(name: str, text: str, remedy: str = "") -> Finding:
    """A finding with a consequence."""
    return Finding(Level.NOTE, name, text, remedy)


def bad(name: str, text: str, remedy: str = "") -> Finding:
    """A finding that has to be remedied."""
    return Finding(Level.BAD, name, text, remedy)


def print_lines(findings: Iterable[Finding], stream: TextIO | None = None) -> list[Finding]:
    """Print findings as they come; returns them. stream: stdout if None."""
    stream = stream or sys.stdout
    coloured = is_coloured(stream)
    found = []
    for finding in findings:
        print(finding.line(coloured=coloured), file=stream, flush=True)
        found.append(finding)
    return found
