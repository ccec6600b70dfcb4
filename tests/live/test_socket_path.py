"""Where the socket is."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from calm_edge.config import ConfigError
from calm_edge.live.socket_path import LONGEST_BYTES, check_length, default_socket


@pytest.fixture(autouse=True)
def alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))


def test_it_is_in_the_units_folder_then_the_users_then_a_temporary_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    temporary = default_socket()
    assert temporary.parent.parent == tmp_path
    assert stat.S_IMODE(temporary.parent.stat().st_mode) == 0o700
    assert default_socket() == temporary
    run = tmp_path / "run"
    run.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(run))
    assert default_socket() == run / "calm-edge" / "live.sock"
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/calm-edge:/run/other")
    assert default_socket() == Path("/run/calm-edge/live.sock")


def test_a_folder_that_others_may_open_is_refused() -> None:
    folder = default_socket().parent
    folder.chmod(0o777)
    with pytest.raises(ConfigError, match="others have access"):
        default_socket()


def test_a_path_too_long_for_a_socket_is_refused(tmp_path: Path) -> None:
    check_length(Path("/" + "a" * (LONGEST_BYTES - 1)))
    with pytest.raises(ConfigError, match="choose a shorter one"):
        check_length(Path("/" + "a" * LONGEST_BYTES))
