"""What a recording shows of itself in the terminal: one live block, or a line now and then."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections import deque
from collections.abc import Mapping

from calm_edge.commands.console import say
from calm_edge.config import Config
from calm_edge.daemon.fan_out import Output
from calm_edge.daemon.health import Health, time_left
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing
from calm_edge.live import kit_content
from calm_edge.live.plan import Plan
from calm_edge.live.sentence import sentence
from calm_edge.types import LocalizerUpdate

# between two plain lines, if the state does not change
LINE_S = 30.0
# that may wait to be printed
LINES = 1000
NAME_WIDTH = 11
_STYLES = {"good": "bold green", "warning": "bold yellow", "bad": "bold red"}


class Lines(Output):
    """Prints the state as a line when it changes, and every LINE_S."""

    name, wants_frames = "terminal", False

    def __init__(self) -> None:
        self._state, self._said_s = "", 0.0

    def status(self, standing: Standing, health: Health | None) -> None:
        now_s = time.monotonic()
        if standing.state == self._state and now_s - self._said_s < LINE_S:
            return
        self._state, self._said_s = standing.state, now_s
        say(str(standing) if health is None else health.line())

    def say_line(self, text: str) -> None:
        """Print a line for the user."""
        say(text)


class Block(Output):
    """Draws one block that is renewed every second, with rich; lines appear above it.

    In lockstep, where no state is reported, it is renewed with every sub-map. It is drawn by the
    thread of this output alone: a terminal that takes no output (Ctrl-S) holds up nothing else. It
    ends when no more frames are taken.
    """

    name, wants_frames = "terminal", False

    def __init__(self, config: Config) -> None:
        from rich.console import Console
        from rich.live import Live

        class KeptCursor(Console):
            """A console with a visible cursor: a program that is killed cannot bring it back."""

            def show_cursor(self, show: bool = True) -> bool:
                return False

        self._console = KeptCursor(stderr=True, highlight=False, soft_wrap=False)
        self._live = Live(
            console=self._console,
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._plan, self._kit = Plan(config.pose_output), kit_content.KitContent()
        self._unit = "m" if config.scale.spacing_m else "spacings"
        self._learned: list[str] = []
        self._length: float | None = None
        self._lines: deque[str] = deque(maxlen=LINES)
        self._drawing = self._reported = False
        self._submaps = 0
        self._handler = _AboveBlock(self)

    def update(self, update: LocalizerUpdate) -> None:
        self._plan.update(update)
        if update.prediction.landmarks is not None:
            self._learned = kit_content.summary(self._kit.update(update))
            self._length = self._plan.length
            self._submaps += 1
            if not self._reported:
                self._draw("LOCKSTEP", _STYLES["good"], "Every window is waited for.", None)

    def status(self, standing: Standing, health: Health | None) -> None:
        self._reported = True
        if health is None:
            self._end()
            return
        level, text = sentence(standing.state, standing.reasons, health.writer.error)
        self._draw(standing.state, _STYLES[level], text, health)

    def say_line(self, text: str) -> None:
        """Print a line for the user, above the block at its next renewal if there is one."""
        if self._drawing:
            self._lines.append(text)
        else:
            say(text)

    def close(self, result: RecordResult) -> None:
        self._end()

    def _end(self) -> None:
        if self._drawing:
            self._live.stop()
            self._handler.remove()
            self._drawing = False
        self._print_lines()

    def _print_lines(self) -> None:
        lines = [self._lines.popleft() for _ in range(len(self._lines))]
        if lines and self._drawing:
            above = "\n".join(f"calm-edge: {line}" for line in lines)
            self._console.print(above, markup=False, soft_wrap=True)
        elif lines:
            for line in lines:
                say(line)

    def _draw(self, state: str, style: str, text: str, health: Health | None) -> None:
        from rich.text import Text

        if not self._drawing:
            self._drawing = True
            self._handler.install()
            self._live.start()
        self._print_lines()
        rows = Text.assemble(("state".ljust(NAME_WIDTH), "dim"), (state, style), f"  {text}")
        # not a table of rich's, whose layout takes three times as long
        for name, value in self._values(health).items():
            rows.append(f"\n{name.ljust(NAME_WIDTH)}", "dim")
            rows.append(value)
        self._live.update(rows, refresh=True)

    def _values(self, health: Health | None) -> Mapping[str, str]:
        values = {"sub-maps": str(self._submaps)} if health is None else _counts(health)
        for line in self._learned:
            name, _, learned = line.partition(": ")
            values[name] = learned
        if self._length is not None:
            values["path"] = f"{self._length:.1f} {self._unit}"
        if health is None:
            return values
        values["disk"] = health.writer.error or time_left(health.writer) or "free space unknown"
        if health.thermal.celsius is not None:
            values["heat"] = f"{health.thermal.celsius:.0f} °C"
        return values


def _counts(health: Health) -> dict[str, str]:
    counts, age = health.counts, health.pose_age_ms
    lost = [f"{n} {why.replace('_', ' ')}" for why, n in health.drops.items() if n]
    frames = f"{counts['primary_frames']} + {counts['assistant_frames']}"
    return {
        "frames": f"{frames}, {', '.join(lost) or 'none lost'}",
        "sub-maps": f"{counts['submaps']} of {counts['windows']} windows",
        "pose": "none at present" if age is None else f"{age:.0f} ms old",
    }


class _AboveBlock(logging.Handler):
    """Prints log messages above the block instead of through it."""

    def __init__(self, block: Block) -> None:
        super().__init__()
        self._block = block
        self._before: list[logging.Handler] = []

    def emit(self, record: logging.LogRecord) -> None:
        self._block.say_line(self.format(record))

    def install(self) -> None:
        """Take the place of the handlers that write to the terminal."""
        root = logging.getLogger()
        self._before = [h for h in root.handlers if isinstance(h, logging.StreamHandler)]
        for handler in self._before:
            root.removeHandler(handler)
        if self._before:
            root.addHandler(self)

    def remove(self) -> None:
        """Give the place back."""
        root = logging.getLogger()
        root.removeHandler(self)
        for handler in self._before:
            root.addHandler(handler)
        self._before = []


def terminal_output(config: Config, environment: Mapping[str, str] = os.environ) -> Lines | Block:
    """The block in a terminal that can show it, else lines.

    Lines with NO_COLOR, in a dumb terminal, where stderr is none, and without rich.
    """
    dumb = environment.get("TERM", "dumb") in ("dumb", "")
    if environment.get("NO_COLOR") or dumb or not sys.stderr.isatty():
        return Lines()
    try:
        return Block(config)
    except ImportError:
        return Lines()
