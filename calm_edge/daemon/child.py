"""Child processes that exchange messages with the capture process through a pipe."""

from __future__ import annotations

import multiprocessing
import queue
import threading
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from calm_edge.processes import CHILD_ENVIRONMENT, environment, signals_held

Target = Callable[..., None]


class Child:
    """A spawned daemonic process running `target(connection, *arguments)`.

    Two threads serve its pipe, so that sending never blocks. Received messages are put into `inbox`
    as (child, message): after a restart, messages of the former process can be discarded.
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
        with environment(CHILD_ENVIRONMENT), signals_held():
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
        """Queue a message. Messages to a dead process are lost; see `alive`."""
        self._outbox.put(message)

    def kill(self) -> None:
        """Kill the process and wait until it is gone."""
        self._process.kill()
        self._process.join()

    def stop(self, message: Any, timeout_s: float) -> None:
        """Send `message`, which asks it to exit; kill it after timeout_s."""
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
    on_arrival: Callable[[Any], None] = lambda _: None,
    idle: Callable[[], bool] = lambda: False,
) -> None:
    """Main loop of a child: answer messages until one of type `stop`, or until the parent exits.

    handle: returns the answer to a message, None for none. on_arrival: called with each message as
    it is received, possibly before earlier ones have been handled. idle: called while no message
    waits, and again for as long as it returns True.
    """
    arrived: deque[Any] = deque()
    while True:
        try:
            while not arrived or connection.poll():
                if not arrived and not connection.poll() and idle():
                    continue
                arrived.append(connection.recv())
                on_arrival(arrived[-1])
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
