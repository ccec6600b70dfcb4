"""Misspelt commands, options and keys name what may have been meant; help has examples."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from calm_edge.cli import COMMANDS, build_parser, main
from calm_edge.commands.examples import EXAMPLES
from calm_edge.similar import similar


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The last line of a command line that is refused."""
    with pytest.raises(SystemExit) as stop:
        main(words)
    assert stop.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["recrod"], "record"),
        (["model", "chekc"], "check"),
        (["--verson"], "--version"),
        (["record", "--out", "x", "--seqence", "y"], "--sequence"),
        (["record", "--seqence=y", "--out", "x"], "--sequence"),
        (["record", "--ouut", "x"], "--out"),
        (["record", "--out", "x", "--pace", "lock-step"], "lockstep"),
        (["model", "check", "calm-geo", "--jsn"], "--json"),
    ],
)
def test_what_may_have_been_meant_is_named(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(capsys, *words).endswith(f"; did you mean {meant}?")


@pytest.mark.parametrize(
    "words", [["zzz"], ["record"], ["record", "--out", "x", "--zzz"], ["record", "--out", "x", "y"]]
)
def test_nothing_is_suggested_for_what_resembles_nothing(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert "did you mean" not in refused(capsys, *words)


def test_an_option_is_not_abbreviated(capsys: pytest.CaptureFixture[str]) -> None:
    assert "did you mean --sequence" in refused(capsys, "record", "--out", "x", "--sequenc", "y")


def test_a_key_of_the_configuration_is_suggested(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--set", "capture.ratehz=3"]) == 1
    assert "capture.ratehz: no such key; did you mean rate_hz?" in capsys.readouterr().err
    assert main(["config", "--set", "captur.rate_hz=3"]) == 1
    assert "captur: no such section; did you mean capture?" in capsys.readouterr().err


def test_several_words_are_suggested_in_order() -> None:
    assert similar(["alpha", "zzz", "gama"], ["gamma", "alpha"]) == "; did you mean alpha, gamma?"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_examples_that_are_parsed(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert EXAMPLES[name]
    for line, what in EXAMPLES[name]:
        program, *words = shlex.split(line.partition(" > ")[0])
        assert program == "calm-edge" and words[0] == name and what
        assert build_parser().parse_args(words).command == name
    with pytest.raises(SystemExit):
        main([name, "--help"])
    help_text = capsys.readouterr().out
    assert "examples:" in help_text and EXAMPLES[name][0][0] in help_text
    assert help_text.index("examples:") < help_text.index("exit codes:")


@pytest.mark.skipif(shutil.which("bash") is None, reason="without bash")
@pytest.mark.parametrize(
    ("typed", "found"),
    [("calm-edge rec", {"record", "recover"}), ("calm-edge record --seq", {"--sequence"})],
)
def test_bash_completes_commands_and_options(
    typed: str, found: set[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["completion", "bash"]) == 0
    script = tmp_path / "calm-edge"
    script.write_text(capsys.readouterr().out)
    function = next(
        line.split()[-2]
        for line in script.read_text().splitlines()
        if "complete" in line and " -F " in line
    )
    words = typed.split()
    run = (
        f"source {script}; COMP_WORDS=({typed}); COMP_CWORD={len(words) - 1}; {function} calm-edge"
    )
    run += f" {words[-1]} {words[-2]}; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    done = subprocess.run(
        ["bash", "-c", run], capture_output=True, text=True, env=os.environ, check=False
    )
    assert {line.strip() for line in done.stdout.splitlines()} == found, done.stderr


def test_zsh_has_a_script_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "zsh"]) == 0
    assert capsys.readouterr().out.startswith("#compdef calm-edge")
