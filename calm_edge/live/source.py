"""The page's end of the socket: connects to a recording whenever there is one."""

from __future__ import annotations

import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from calm_edge.live.board import Board
from calm_edge.live.sentence import BAD, WARNING, sentence
from calm_edge.live.wire import Message, WireError, receive

RETRY_S = 1.0
# a recording sends something twice a second
SILENT_S = 5.0


class Source:
    """Receives a recording's messages in a thread of its own, and puts them on a board.

    path: the recording's socket. board: messages of the recording as they come, and of kind `state`
    the state in a sentence, also while there is no recording.
    """

    def __init__(self, path: Path, board: Board[Message]) -> None:
        self._path, self._board = path, board
        self._closed = threading.Event()
        self._connection: socket.socket | None = None
        self._ended = ""
        self._thread = threading.Thread(target=self._run, name="live-source", daemon=True)
        self._alone()
        self._thread.start()

    @property
    def connected(self) -> bool:
        return self._connection is not None

    def ask(self, kind: str, content: Mapping[str, Any]) -> bool:
        """Send a request to the recording; False if there is none."""
        connection = self._connection
        if connection is None:
            return False
        try:
            connection.sendall(Message(kind, content).encoded())
        except OSError:
            return False
        return True

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        if (connection := self._connection) is not None:
            with suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)
        self._thread.join(2.0)
        self._board.close()

    def _run(self) -> None:
        while not self._closed.is_set():
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
                try:
                    connection.connect(str(self._path))
                except OSError:
                    self._closed.wait(RETRY_S)
                    continue
                self._board.clear()
                self._ended = ""
                connection.settimeout(SILENT_S)
                self._connection = connection
                self._state(WARNING, "Recording; its state is not known yet.")
                with suppress(OSError, WireError):
                    self._receive(connection)
                self._connection = None
                self._alone()
            self._closed.wait(RETRY_S)

    def _receive(self, connection: socket.socket) -> None:
        # a file of a socket cannot be read on after a time limit: begin anew then
        with connection.makefile("rb") as stream:
            while (message := receive(stream)) is not None:
                self._take(message)

    def _take(self, message: Message) -> None:
        if message.kind == "beat":
            return
        self._board.put(message.kind, message)
        if message.kind == "health":
            content = message.content
            error = str(content.get("disk", {}).get("error") or "")
            level, text = sentence(content["state"], content["reasons"], error)
            self._state(level, text)
        elif message.kind == "end":
            losses = [message.content["error"], *message.content["losses"]]
            self._ended = "; ".join(filter(None, losses))

    def _alone(self) -> None:
        """Report that there is no recording."""
        if self._board.get("end") is not None:
            why = f": {self._ended}" if self._ended else ", nothing was lost"
            self._state(BAD if self._ended else WARNING, f"The recording has ended{why}.")
        elif self._board.get("drive") is not None:
            self._state(BAD, "The recording does not answer any more.")
        else:
            self._state(
                WARNING, "No recording runs here. Start one with: calm-edge record --live ..."
            )

    def _state(self, level: str, text: str) -> None:
        content = {"level": level, "text": text, "recording": self.connected}
        self._board.put("state", Message("state", content))
