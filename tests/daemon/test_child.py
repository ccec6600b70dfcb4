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


def test_an_idle_child_works_until_a_message_comes() -> None:
    ours, theirs = Pipe()
    met: list[str] = []

    def idle() -> bool:
        met.append("idle")
        if met.count("idle") == 3:
            ours.send(1)
            ours.send(Stop())
        return True

    serve(theirs, Stop, lambda message: met.append(f"handle {message}"), idle=idle)
    assert met == ["idle", "idle", "idle", "handle 1"]


def test_an_idle_child_waits_once_nothing_is_left() -> None:
    ours, theirs = Pipe()
    calls: list[bool] = []

    def idle() -> bool:
        calls.append(len(calls) < 2)
        if not calls[-1]:
            ours.send(Stop())
        return calls[-1]

    serve(theirs, Stop, lambda message: message, idle=idle)
    assert calls == [True, True, False]
