"""A child process and its two threads: a send never blocks, what it says is queued."""

from __future__ import annotations

import multiprocessing
import queue
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from calm_edge.processes import CHILD_ENVIRONMENT, environment

Target = Callable[..., None]


class Child:
    """A spawned daemonic process running `target(connection, *arguments)`.

    Its messages are put into `inbox` as (child, message): an answer of a child that has been
    replaced is told apart by identity.
    """

    def __init__(
        self, name: str, target: Target, arguments: tuple[Any, ...], inbox: queue.Queue[Any]
    ) -> None:
        self.name = name
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(
            target=target, args=(theirs, *arguments), name=f"calm-edge-{name}", daemon=True
        )
        with environment(CHILD_ENVIRONMENT):
            self._process.start()
        theirs.close()
        self._inbox = inbox
        self._outbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        for work in (self._send_all, self._receive_all):
            threading.Thread(target=work, name=f"{name}-pipe", daemon=True).start()

    @property
    def pid(self) -> int:
        return int(self._process.pid or 0)

    @property
    def alive(self) -> bool:
        return self._process.is_alive()

    @property
    def exit_code(self) -> int | None:
        return self._process.exitcode

    def send(self, message: Any) -> None:
        """Queues a message; a dead child's messages vanish, its death is seen by `alive`."""
        self._outbox.put(message)

    def kill(self) -> None:
        """Ends it at once; it is then no longer `alive`."""
        self._process.kill()
        self._process.join()

    def stop(self, message: Any, timeout_s: float) -> None:
        """Asks it to end, waits, then ends it."""
        self.send(message)
        self._process.join(timeout_s)
        if self._process.is_alive():
            self.kill()
        self._outbox.put(None)

    def _send_all(self) -> None:
        for message in iter(self._outbox.get, None):
            try:
                self._connection.send(message)
            except (OSError, ValueError):
                return

    def _receive_all(self) -> None:
        while True:
            try:
                message = self._connection.recv()
            except (EOFError, OSError):
                return
            self._inbox.put((self, message))


def serve(
    connection: Connection,
    stop: type,
    handle: Callable[[Any], Any],
    overhear: Callable[[Any], None] = lambda _: None,
) -> None:
    """A child's main loop: answers each message until `stop` comes or the parent is gone.

    overhear: gets every message that is there before the first of them is handled.
    """
    arrived: deque[Any] = deque()
    while True:
        try:
            while not arrived or connection.poll():
                arrived.append(connection.recv())
                overhear(arrived[-1])
        except (EOFError, OSError):
            return
        message = arrived.popleft()
        if isinstance(message, stop):
            return
        answer = handle(message)
        if answer is not None:
            try:
                connection.send(answer)
            except OSError:
                return
