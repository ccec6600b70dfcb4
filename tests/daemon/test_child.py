"""Main loop of a child process."""

from __future__ import annotations

from multiprocessing import Pipe
from typing import Any

from calm_edge.daemon.child import serve
from calm_edge.daemon.messages import Stop


def test_all_arrived_messages_are_noted_before_the_first_is_handled() -> None:
    ours, theirs = Pipe()
    for message in (1, 2, 3, Stop()):
        ours.send(message)
    met: list[str] = []

    def handle(message: Any) -> Any:
        met.append(f"handle {message}")
        return 10 * message

    serve(theirs, Stop, handle, lambda m: met.append(f"note {m}") if m != Stop() else None)
    assert met == [*(f"note {i}" for i in (1, 2, 3)), *(f"handle {i}" for i in (1, 2, 3))]
    assert [ours.recv() for _ in range(3)] == [10, 20, 30]


def test_serve_ends_with_the_parent() -> None:
    ours, theirs = Pipe()
    ours.close()
    serve(theirs, Stop, lambda message: message)
