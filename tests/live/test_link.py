"""A recording's socket and the page's end of it."""

from __future__ import annotations

import os
import socket
import stat
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from calm_edge.live import link as link_module
from calm_edge.live.board import Board
from calm_edge.live.link import Link, answers
from calm_edge.live.source import Source
from calm_edge.live.wire import Message


def until(condition: Callable[[], bool], timeout_s: float = 20) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "never happened"
        time.sleep(0.01)


class Recording:
    """A recording's end with what it was asked."""

    def __init__(self, path: Path) -> None:
        self.board: Board[bytes] = Board()
        self.asked: list[Message] = []
        self.link = Link(path, self.board, self.asked.append)

    def put(self, kind: str, **content: object) -> None:
        self.board.put(kind, Message(kind, content).encoded())


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "live.sock"


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("calm_edge.live.source.RETRY_S", 0.05)
    monkeypatch.setattr(link_module, "RETRY_S", 0.05)
    monkeypatch.setattr(link_module, "POLL_S", 0.1)


def text_of(board: Board[Message]) -> str:
    state = board.get("state")
    return "" if state is None else str(state.content["text"])


def test_the_page_waits_for_a_recording_follows_it_and_says_when_it_ends(path: Path) -> None:
    board: Board[Message] = Board()
    source = Source(path, board)
    assert "No recording runs here" in text_of(board) and not source.ask("event", {})
    recording = Recording(path)
    recording.put("drive", unit="m")
    recording.put("health", state="LOST", reasons=["no pose for 3 s"])
    until(lambda: "lost" in text_of(board))
    assert text_of(board) == "Recording, but the pose is lost – no pose for 3 s."
    assert source.ask("event", {"text": "here"})
    until(lambda: recording.asked == [Message("event", {"text": "here"})])
    recording.put("end", error="", losses=["2 frames came corrupt from the cameras"])
    recording.link.close(2.0)
    until(lambda: "ended" in text_of(board))
    assert "2 frames came corrupt" in text_of(board) and not path.exists()
    # the next drive begins with nothing of the former one
    following = Recording(path)
    following.put("drive", unit="spacings")
    until(lambda: board.get("end") is None and board.get("drive") is not None)
    assert board.get("health") is None
    following.link.close(2.0)
    source.close()


def test_a_recording_that_was_killed_is_reported_and_its_socket_replaced(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as killed:
        killed.bind(str(path))
    assert path.is_socket() and not answers(path)
    recording, board = Recording(path), Board[Message]()
    source = Source(path, board)
    recording.put("drive", unit="m")
    until(lambda: board.get("drive") is not None)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    # nothing is said at the end
    recording.board.close()
    recording.link.close(2.0)
    until(lambda: "does not answer" in text_of(board))
    source.close()


def test_a_second_recording_leaves_the_socket_to_the_first_and_takes_it_later(path: Path) -> None:
    first = Recording(path)
    until(lambda: answers(path))
    second = Recording(path)
    until(lambda: "another recording" in second.link.fault)
    assert first.link.fault == ""
    first.link.close(2.0)
    until(lambda: second.link.fault == "" and answers(path))
    second.link.close(2.0)


def test_a_socket_that_cannot_be_made_is_a_fault_until_it_can(tmp_path: Path) -> None:
    path = tmp_path / "absent" / "live.sock"
    recording = Recording(path)
    until(lambda: "No such file" in recording.link.fault)
    assert recording.link.fault.startswith(f"live: {path}: ")
    path.parent.mkdir()
    until(lambda: answers(path))
    assert recording.link.fault == ""
    recording.link.close(2.0)


def test_another_file_at_the_path_is_left_alone(path: Path) -> None:
    path.write_text("precious")
    recording = Recording(path)
    until(lambda: bool(recording.link.fault))
    recording.link.close(2.0)
    assert path.read_text() == "precious"


def test_a_reader_that_takes_nothing_is_dropped_and_holds_up_nobody(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link_module, "STALL_S", 0.3)
    recording = Recording(path)
    until(lambda: answers(path))
    with socket.socket(socket.AF_UNIX) as silent:
        silent.connect(str(path))
        until(lambda: recording.link.readers == 1)
        board: Board[Message] = Board()
        source = Source(path, board)
        longest_s, number = 0.0, 0
        while recording.link.dropped == 0:
            number += 1
            started_s = time.monotonic()
            picture = Message("primary", {"number": number}, os.urandom(200_000))
            recording.board.put("primary", picture.encoded())
            longest_s = max(longest_s, time.monotonic() - started_s)
            time.sleep(0.02)
            assert number < 1000
        # putting never waited for the reader
        assert longest_s < 0.25
        until(lambda: (board.get("primary") or Message("", {"number": 0})).content["number"] > 1)
        until(lambda: recording.link.readers == 1)
    source.close()
    recording.link.close(2.0)


def test_bytes_that_are_no_request_end_that_connection_alone(path: Path) -> None:
    recording = Recording(path)
    until(lambda: answers(path))
    with socket.socket(socket.AF_UNIX) as wrong:
        wrong.connect(str(path))
        wrong.sendall(b"GET / HTTP/1.1\r\n\r\n")
        wrong.settimeout(10)
        with suppress(ConnectionResetError):
            while wrong.recv(1 << 16):
                pass
    assert recording.asked == [] and answers(path)
    recording.link.close(2.0)
