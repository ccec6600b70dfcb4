"""`calm-edge live` as a process."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection
from pathlib import Path

import pytest

from calm_edge.cli import main


@contextmanager
def live(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command and the first line that it prints; ended by SIGINT, with exit code 0."""
    command = [sys.executable, "-m", "calm_edge.cli", "live", *arguments]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline()
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0
        finally:
            process.kill()


def status(address: str) -> int:
    host, port, path = re.fullmatch(r"http://([\d.]+):(\d+)(/.*)", address.strip()).groups()  # type: ignore[union-attr]
    connection = HTTPConnection(host, int(port), timeout=10)
    try:
        connection.request("GET", path)
        return connection.getresponse().status
    finally:
        connection.close()


def test_it_serves_this_computer_alone_and_waits_for_a_recording(tmp_path: Path) -> None:
    socket = str(tmp_path / "live.sock")
    with live("--address", "127.0.0.1:0", "--socket", socket) as (process, line):
        assert re.fullmatch(r"page        http://127\.0\.0\.1:\d+/\n", line)
        assert status(line.split()[1]) == 200
        assert process.stderr is not None
        assert "record --live offers one" in process.stderr.readline()


def test_beyond_this_computer_it_requires_a_token(tmp_path: Path) -> None:
    socket, token = str(tmp_path / "live.sock"), tmp_path / "token"
    with live("--address", "0.0.0.0:0", "--socket", socket, "--token-file", str(token)) as (
        _,
        line,
    ):
        found = re.fullmatch(r"page        (http://[\d.]+:)(\d+)/\?token=([\w-]{16,})\n", line)
        assert found and found[3] == token.read_text().strip()
        assert status(f"http://127.0.0.1:{found[2]}/") == 401
        assert status(f"http://127.0.0.1:{found[2]}/?token={found[3]}") == 303


@pytest.mark.parametrize(
    "arguments, text",
    [
        (["--address", "car:8600"], "expected an IP address"),
        (["--address", "192.0.2.1:8600"], "choose an address of this computer"),
        (["--socket", "/" + "x" * 120], "choose a shorter one"),
        (["--token-file", "/absent/token"], "--token-file /absent/token: No such file"),
    ],
)
def test_what_cannot_be_served_is_one_line(
    arguments: list[str], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["live", "--socket", str(tmp_path / "live.sock"), "--address", "127.0.0.1:0"]
    assert main([*base, *arguments]) == 1
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert text in line
