"""HTTP server of a page: its files, the stream of what is new, and its requests."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cache
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from socket import AF_INET, AF_INET6
from typing import Any
from urllib.parse import parse_qs, urlsplit

from calm_edge.config import ConfigError
from calm_edge.live import picture
from calm_edge.live.access import Access, Address
from calm_edge.live.board import Board
from calm_edge.live.wire import Message
from calm_edge.types import CalmEdgeError

COOKIE, PAGE_HEADER = "calm_edge_token", "X-Calm-Edge"
# pages at a time; silence on a stream is broken so that a page notices a lost connection
MAX_STREAMS, BEAT_S = 8, 2.0
# least time between two messages of a stream
PAUSE_S = 0.2
REQUEST_S, BODY_BYTES = 10.0, 2048
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}
Ask = Callable[[str, Mapping[str, Any]], bool]


@dataclass(frozen=True, slots=True)
class Page:
    """What is served. files: path -> type and content. requests: the names that it may send.

    command: the one that prints its address, for messages.
    """

    files: Mapping[str, tuple[str, bytes]]
    requests: Collection[str]
    command: str


class Server(ThreadingHTTPServer):
    """Server of the page, a thread a connection.

    address: to listen on. access: who may use it. page: what is served. board: what it shows.
    ask: passes a request on, False if there is no recording; raises CalmEdgeError with why a
    request is refused. Raises ConfigError if the address cannot be used.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = 16

    def __init__(
        self, address: Address, access: Access, page: Page, board: Board[Message], ask: Ask
    ) -> None:
        self.address_family = AF_INET6 if ":" in address.host else AF_INET
        self.access, self.page, self.board, self.ask = access, page, board, ask
        self.streams = threading.BoundedSemaphore(MAX_STREAMS)
        self.pictures = Pictures()
        try:
            super().__init__((address.host, address.port), Handler)
        except OSError as error:
            raise ConfigError(
                f"--address {address.host}:{address.port}: {error.strerror}; choose an address of "
                "this computer and another port"
            ) from None

    @property
    def port(self) -> int:
        return int(self.server_address[1])

    def close(self, timeout_s: float = 2.0) -> None:
        """Send what is on the board, and end; pages that take longer get less of it."""
        self.board.close()
        end = time.monotonic() + timeout_s
        for _ in range(MAX_STREAMS):
            self.streams.acquire(timeout=max(0.0, end - time.monotonic()))
        self.shutdown()
        self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore browsers that go away; report other errors."""
        import sys

        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)


class Pictures:
    """The newest picture of each eye made small, once for all pages."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[Message, dict[str, Any] | None]] = {}

    def small(self, message: Message) -> dict[str, Any] | None:
        """Content for the page; None if the picture cannot be decoded."""
        with self._lock:
            known = self._newest.get(message.kind)
            if known is None or known[0] is not message:
                self._newest[message.kind] = known = message, picture.content(message)
            return known[1]


class Handler(BaseHTTPRequestHandler):
    """Answers one connection."""

    protocol_version = "HTTP/1.1"
    server_version, sys_version = "calm-edge", ""
    # for reading a request
    timeout = REQUEST_S
    server: Server

    def do_GET(self) -> None:
        """Answer with a file of the page, or the stream."""
        path, _, query = self.path.partition("?")
        offered = parse_qs(query).get("token", [""])[0]
        if not self._allowed(offered):
            return
        if offered and self.server.access.token:
            # out of the address, which is shown, remembered and shared
            self._answer(
                HTTPStatus.SEE_OTHER,
                headers={
                    "Location": "/",
                    "Set-Cookie": f"{COOKIE}={offered}; Path=/; Max-Age=31536000; HttpOnly; "
                    "SameSite=Strict",
                },
            )
        elif path == "/stream":
            self._stream()
        elif found := self.server.page.files.get("/index.html" if path == "/" else path):
            self._answer(HTTPStatus.OK, found[1], found[0])
        else:
            self._answer(HTTPStatus.NOT_FOUND, b"There is no such page.\n")

    def do_POST(self) -> None:
        """Pass a request on, a path such as `/event` with a JSON object."""
        if not self._allowed():
            return
        # only a page of ours can set the header: browsers ask us first before another site may
        if not self.headers.get(PAGE_HEADER):
            self._answer(HTTPStatus.FORBIDDEN, b"Use the buttons of the page.\n")
            return
        kind = urlsplit(self.path).path.removeprefix("/")
        content = self._body()
        if kind not in self.server.page.requests or content is None:
            self._answer(HTTPStatus.BAD_REQUEST, b"No such request.\n")
            return
        try:
            passed = self.server.ask(kind, content)
        except CalmEdgeError as error:
            self._answer(HTTPStatus.CONFLICT, f"{error}\n".encode())
            return
        if passed:
            self._answer(HTTPStatus.ACCEPTED, b"Passed on.\n")
        else:
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, b"No recording runs here.\n")

    def _allowed(self, offered: str = "") -> bool:
        """Whether to answer; if not, why has been sent."""
        access = self.server.access
        if not access.serves(self.headers.get("Host", "")):
            self._answer(
                HTTPStatus.FORBIDDEN,
                b"Served under the names of this computer alone: open http://localhost\n",
            )
            return False
        if access.knows(offered or self._cookie()):
            return True
        self._answer(
            HTTPStatus.UNAUTHORIZED,
            b"The token is missing or wrong: open the whole address that "
            + f"{self.server.page.command} printed.\n".encode(),
        )
        return False

    def _cookie(self) -> str:
        try:
            found = SimpleCookie(self.headers.get("Cookie", "")).get(COOKIE)
        except CookieError:
            return ""
        return found.value if found else ""

    def _body(self) -> dict[str, Any] | None:
        """JSON object of a request; None if there is none, or it is too long."""
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > BODY_BYTES:
            self.close_connection = True
            return None
        try:
            content = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            return None
        return content if isinstance(content, dict) else None

    def _stream(self) -> None:
        """Send what is new as server-sent events until the browser goes away."""
        server = self.server
        if not server.streams.acquire(blocking=False):
            self._answer(HTTPStatus.SERVICE_UNAVAILABLE, b"Too many pages are open.\n")
            return
        try:
            self.close_connection = True
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/event-stream")
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            version, pause, ended = 0, threading.Event(), False
            while not ended:
                # what was put before the end is still sent
                ended = server.board.closed
                version, new = server.board.changes(version, BEAT_S)
                # a picture nobody can decode is left out
                events = [text for _, message in new if (text := self._event(message))]
                self.wfile.write("".join(events or ["event: beat\ndata: {}\n\n"]).encode())
                self.wfile.flush()
                pause.wait(PAUSE_S)
        finally:
            server.streams.release()

    def _event(self, message: Message) -> str:
        content: Mapping[str, Any] | None = message.content
        if message.data:
            content = self.server.pictures.small(message)
        return f"event: {message.kind}\ndata: {json.dumps(content)}\n\n" if content else ""

    def _answer(
        self,
        status: HTTPStatus,
        body: bytes = b"",
        kind: str = "text/plain",
        headers: Mapping[str, str] | None = None,
    ) -> None:
        self.send_response(status)
        for name, value in {**_HEADERS, **(headers or {})}.items():
            self.send_header(name, value)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Log nothing: a token may be in an address."""


@cache
def page_files(package: str, folder: str) -> Mapping[str, tuple[str, bytes]]:
    """Path -> type and content of a page's files, and of those that all pages share."""
    found = {}
    for place in (files("calm_edge.live") / "shared", files(package) / folder):
        for entry in place.iterdir():
            dot, end = entry.name.rpartition(".")[1:]
            if kind := _TYPES.get(dot + end):
                found[f"/{entry.name}"] = kind, entry.read_bytes()
    return found


def live_page() -> Page:
    """The page that shows a recording."""
    return Page(page_files("calm_edge.live", "page"), ("event", "keep"), "calm-edge live")
