from __future__ import annotations

import io

import pytest

from calm_edge.commands.finding import bad, good, note, print_lines


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


FOUND = (good("clock", "synchronised"), note("disk", "small", "delete files"), bad("x", "gone"))


def test_a_pipe_gets_plain_lines(capsys: pytest.CaptureFixture[str]) -> None:
    assert print_lines(FOUND) == list(FOUND)
    assert capsys.readouterr().out.splitlines() == [
        "ok    clock: synchronised",
        "note  disk: small; delete files",
        "fail  x: gone",
    ]


@pytest.mark.parametrize(("variable", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_a_terminal_gets_colours_unless_refused(
    variable: str, value: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    print_lines(FOUND, stream)
    assert "\x1b[31mfail \x1b[0m x: gone" in stream.getvalue()
    monkeypatch.setenv(variable, value)
    plain = Terminal()
    print_lines(FOUND, plain)
    assert "\x1b" not in plain.getvalue()
