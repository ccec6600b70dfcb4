"""`make eval` measures everything, whatever is missed on the way, and says so at the end."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = ["targets", "kilometres.tables", *["mapping"] * 4, "pixels", "tables"]


def _evaluated(folder: Path, missed: str, recorded: tuple[str, ...]) -> tuple[int, list[str]]:
    """The exit code, and the commands that a stand-in for python was given."""
    shutil.copy(ROOT / "Makefile", folder)
    for name in ("requirements.txt", "requirements-dev.txt", "requirements-systemd.txt"):
        (folder / name).touch()
    for name in (".venv/bin", "deploy", *(f"build/eval/{row}/recording" for row in recorded)):
        (folder / name).mkdir(parents=True)
    (folder / "deploy" / "setup.sh").touch()
    (folder / ".venv" / ".stamp").touch()
    python = folder / ".venv" / "bin" / "python"
    python.write_text(f'#!/bin/sh\necho "$@"\n[ "$3" != {missed or "-"} ]\n')
    python.chmod(0o755)
    done = subprocess.run(["make", "eval"], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout.splitlines()


@pytest.mark.parametrize("missed", ["", "targets", "mapping", "tables"])
def test_a_missed_target_stops_nothing_and_is_told_at_the_end(tmp_path: Path, missed: str) -> None:
    code, given = _evaluated(tmp_path, missed, ("demo", "aalborg"))
    commands = [line.split() for line in given if line.startswith("-m ")]
    assert [c[1:3] for c in commands] == [["bench", name] for name in COMMANDS]
    assert bool(code) == bool(missed)
    assert commands[2][3:] == ["build/eval/demo/recording", "--truth", "demo/drive"]
    assert commands[5][-2:] == ["--warp", "0.05"]


def test_a_drive_that_was_not_recorded_is_left_out(tmp_path: Path) -> None:
    code, given = _evaluated(tmp_path, "", ("demo",))
    assert code == 0 and not any("aalborg" in line for line in given)
