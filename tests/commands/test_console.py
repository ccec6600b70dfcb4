from __future__ import annotations

import pytest

from calm_edge.commands.console import messages_of, say


def test_messages_name_the_drive_while_several_are_worked_on(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with messages_of("monday"):
        say("solving windows: 3 of 11")
    say("done")
    lines = capsys.readouterr().err.splitlines()
    assert lines == ["calm-edge: monday: solving windows: 3 of 11", "calm-edge: done"]
