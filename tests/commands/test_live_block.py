"""What `record` shows of itself in a terminal and in a pipe."""

from __future__ import annotations

import io
import logging
import os
import re
import select
import sys
from collections.abc import Iterator
from dataclasses import replace

import pytest

from calm_edge.commands import live_block
from calm_edge.commands.live_block import Block, Lines, terminal_output
from calm_edge.config import Config
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing, State
from tests.daemon.test_health import HEALTH
from tests.recording import samples

RUNNING = Standing(State.RUNNING)


class Terminal:
    """A pseudo-terminal, after `attach` in place of stderr."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._monkeypatch = monkeypatch
        self.far, self.near = os.openpty()
        self.file = os.fdopen(self.near, "w", buffering=1)

    def attach(self) -> None:
        """Take the place of stderr; within a test, as pytest replaces it before."""
        self._monkeypatch.setattr(sys, "stderr", self.file)

    def text(self) -> str:
        """What was written so far."""
        data = b""
        while select.select([self.far], [], [], 0.1)[0]:
            data += os.read(self.far, 65536)
        return data.decode()


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Terminal]:
    terminal = Terminal(monkeypatch)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "120")
    monkeypatch.delenv("NO_COLOR", raising=False)
    yield terminal
    terminal.file.close()
    os.close(terminal.far)


def test_a_terminal_gets_the_block_and_others_get_lines(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal.attach()
    able = {"TERM": "xterm"}
    assert isinstance(terminal_output(Config(), able), Block)
    assert isinstance(terminal_output(Config(), able | {"NO_COLOR": "1"}), Lines)
    assert isinstance(terminal_output(Config(), {"TERM": "dumb"}), Lines)
    assert isinstance(terminal_output(Config(), {}), Lines)
    for name in [name for name in sys.modules if name.partition(".")[0] == "rich"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rich", None)
    assert isinstance(terminal_output(Config(), able), Lines)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert isinstance(terminal_output(Config(), able), Lines)


def test_the_block_has_state_counts_kit_path_and_disk(terminal: Terminal) -> None:
    terminal.attach()
    block = Block(Config())
    block.update(samples.update())
    block.status(RUNNING, HEALTH)
    text = terminal.text()
    assert "RUNNING" in text and "Recording, and the pose is live." in text
    for name in ("frames", "sub-maps", "pose", "primary", "assistant", "path", "disk", "heat"):
        assert name in text, name
    assert "± 3.0 %" in text and "spacings" in text and "61 °C" in text
    # a killed program could not bring the cursor back
    assert "\x1b[?25l" not in text
    block.close(RecordResult())


def test_lines_and_log_messages_appear_above_the_block_and_the_handlers_come_back(
    terminal: Terminal,
) -> None:
    terminal.attach()
    handler = logging.StreamHandler(terminal.file)
    root = logging.getLogger()
    root.addHandler(handler)
    try:
        block = Block(Config())
        block.status(RUNNING, HEALTH)
        terminal.text()
        block.say_line("[a/b.jpg]: left out")
        logging.getLogger("test").warning("a warning")
        assert terminal.text() == ""
        block.status(RUNNING, HEALTH)
        text = terminal.text()
        assert text.index("[a/b.jpg]: left out") < text.index("a warning") < text.rindex("frames")
        # drawn once for the lines, and once with the new state
        assert text.count("frames") == 2
        assert handler not in root.handlers
        block.say_line("the last line")
        block.status(Standing(State.STOPPING), None)
        block.say_line("finishing: 3 windows left to solve")
        text = terminal.text()
        assert text.index("the last line") < text.index("finishing: 3")
        assert handler in root.handlers
        block.close(RecordResult())
    finally:
        root.removeHandler(handler)


def test_in_lockstep_the_block_is_renewed_with_every_sub_map(terminal: Terminal) -> None:
    terminal.attach()
    block = Block(Config())
    block.update(samples.update())
    text = terminal.text()
    assert "LOCKSTEP" in text and "± 3.0 %" in text and "path" in text and "disk" not in text
    block.update(samples.update(1))
    assert re.search(r"sub-maps +\S*2", terminal.text())
    block.status(Standing(State.STOPPING), None)
    terminal.text()
    # the end of a drive gives its sub-maps once more
    block.update(samples.update(1))
    assert terminal.text() == ""
    block.close(RecordResult())


def test_a_terminal_that_takes_nothing_does_not_hold_up_a_line(terminal: Terminal) -> None:
    terminal.attach()
    block = Block(Config())
    block.status(RUNNING, HEALTH)
    for i in range(5000):
        block.say_line(f"line {i}")
    assert len(block._lines) == live_block.LINES
    block._lines.clear()
    block.close(RecordResult())


def test_lines_are_printed_when_the_state_changes_and_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = Lines()
    for standing in (RUNNING, RUNNING, Standing(State.LOST, ("no pose for 2.0 s",)), RUNNING):
        lines.status(standing, replace(HEALTH, standing=standing))
    printed = capsys.readouterr().err.splitlines()
    assert [line.split()[1].rstrip(":") for line in printed] == ["RUNNING", "LOST", "RUNNING"]
    assert printed[0] == f"calm-edge: {replace(HEALTH, standing=RUNNING).line()}"
    monkeypatch.setattr(live_block, "LINE_S", 0.0)
    lines.status(RUNNING, HEALTH)
    lines.status(Standing(State.STOPPING), None)
    assert capsys.readouterr().err.splitlines()[1:] == ["calm-edge: STOPPING"]
