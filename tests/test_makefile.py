"""`make eval` measures everything and fails at the end if a target was missed; set-up by need."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DECLARED = ("pyproject.toml", "constraints.txt", "deploy/setup.sh")
COMMANDS = ["targets", "kilometres.tables", *["mapping"] * 4, "pixels", "tables"]


def _evaluated(folder: Path, missed: str, recorded: tuple[str, ...]) -> tuple[int, list[str]]:
    """The exit code, and the commands that a stand-in for python was given."""
    shutil.copy(ROOT / "Makefile", folder)
    for name in (".venv/bin", "deploy", *(f"build/eval/{row}/recording" for row in recorded)):
        (folder / name).mkdir(parents=True)
    for name in (*DECLARED, ".venv/.stamp"):
        (folder / name).touch()
    python = folder / ".venv" / "bin" / "python"
    python.write_text(f'#!/bin/sh\necho "$@"\n[ "$3" != {missed or "-"} ]\n')
    python.chmod(0o755)
    done = subprocess.run(["make", "eval"], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.splitlines()


@pytest.mark.parametrize("missed", ["", "targets", "mapping", "tables"])
def test_a_missed_target_stops_nothing_and_fails_at_the_end(tmp_path: Path, missed: str) -> None:
    code, given = _evaluated(tmp_path, missed, ("demo", "aalborg"))
    commands = [line.split() for line in given if line.startswith("-m ")]
    assert [c[1:3] for c in commands] == [["bench", name] for name in COMMANDS]
    assert bool(code) == bool(missed)
    assert commands[2][3:] == ["build/eval/demo/recording", "--truth", "demo/drive"]
    assert commands[5][-2:] == ["--warp", "0.05"]


def test_a_drive_that_was_not_recorded_is_left_out(tmp_path: Path) -> None:
    code, given = _evaluated(tmp_path, "", ("demo",))
    assert code == 0 and not any("aalborg" in line for line in given)


def _set_up(folder: Path, *target: str) -> list[str]:
    """The extras that a target has installed, by a stand-in for setup.sh."""
    done = subprocess.run(
        ["make", *target], cwd=folder, capture_output=True, text=True, check=False
    )
    return [line.split()[1] for line in done.stdout.splitlines() if line.startswith("extras ")]


def test_only_tests_and_lint_install_the_tools_for_them(tmp_path: Path) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in (".venv", "deploy"):
        (tmp_path / name).mkdir()
    for name in DECLARED:
        (tmp_path / name).touch()
    script = tmp_path / "deploy" / "setup.sh"
    script.write_text('#!/bin/sh\necho extras "${1:-none}"\n')
    script.chmod(0o755)
    assert _set_up(tmp_path, "setup") == ["none"] and _set_up(tmp_path, "demo") == []
    assert _set_up(tmp_path, "test") == ["oak,import,laz,geo,dask,dev"]
    assert _set_up(tmp_path, "lint") == _set_up(tmp_path, "setup") == []
    os.utime(tmp_path / "pyproject.toml")
    assert _set_up(tmp_path, "setup", "EXTRAS=oak,import") == ["oak,import"]
    os.utime(tmp_path / "pyproject.toml")
    assert _set_up(tmp_path, "lint") == ["oak,import,laz,geo,dask,dev"]
    assert _set_up(tmp_path, "demo") == []
