"""The newest message of each kind, for slow readers."""

from __future__ import annotations

import threading
import time

from calm_edge.live.board import Board


def test_a_reader_gets_the_newest_of_each_kind_in_order() -> None:
    board: Board[int] = Board()
    for value in range(5):
        board.put("a", value)
    board.put("b", 7)
    board.put("a", 9)
    version, new = board.changes(0, 1.0)
    assert new == [("b", 7), ("a", 9)] and board.get("a") == 9
    board.put("b", 8)
    version, new = board.changes(version, 1.0)
    assert new == [("b", 8)]
    assert board.changes(version, 0.01)[1] == []


def test_a_reader_waits_and_is_woken() -> None:
    board: Board[str] = Board()
    threading.Timer(0.05, board.put, ("a", "here")).start()
    started_s = time.monotonic()
    assert board.changes(0, 10.0)[1] == [("a", "here")]
    assert time.monotonic() - started_s < 5
    threading.Timer(0.05, board.close).start()
    assert board.changes(1, 10.0)[1] == [] and board.closed
    assert time.monotonic() - started_s < 5


def test_what_was_cleared_is_not_given_and_later_messages_are() -> None:
    board: Board[int] = Board()
    board.put("a", 1)
    version, _ = board.changes(0, 1.0)
    board.clear()
    assert board.get("a") is None
    board.put("b", 2)
    assert board.changes(0, 1.0)[1] == board.changes(version, 1.0)[1] == [("b", 2)]
