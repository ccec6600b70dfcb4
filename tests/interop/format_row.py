"""A row of the table of formats, and the command line that makes what it is about."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from calm_edge.cli import main
from calm_edge.commands.exit_codes import LOSS, OK


@dataclass(frozen=True, slots=True)
class Reading:
    """What another reader has found: its name, figures in words, and whether they agree."""

    reader: str
    figures: str
    agrees: bool


@dataclass(frozen=True, slots=True)
class Row:
    """A format and how it is read. read: takes a new folder; ImportError: a reader is absent."""

    name: str
    source: str
    read: Callable[[Path], Reading]


def calm_edge(*arguments: str | Path) -> str:
    """Run a command; return what it prints. Raises RuntimeError with its last line if it fails."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(each) for each in arguments])
    if code not in (OK, LOSS):
        raise RuntimeError(f"calm-edge {arguments[0]}: exit {code}: {err.getvalue().strip()}")
    return out.getvalue()
