"""The page's HTTP server, used without a browser."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from http.client import HTTPConnection, HTTPResponse
from typing import Any

import cv2
import numpy as np
import pytest

from calm_edge.config import ConfigError
from calm_edge.live import server as server_module
from calm_edge.live.access import Access, Address
from calm_edge.live.board import Board
from calm_edge.live.server import COOKIE, Server, live_page
from calm_edge.live.wire import Message

TOKEN = "a-token-of-this-test"


class Page:
    """A server with what it was asked to pass on."""

    def __init__(self, token: str = "") -> None:
        self.board: Board[Message] = Board()
        self.asked: list[tuple[str, Mapping[str, Any]]] = []
        self.recording = True
        self._opened: list[HTTPConnection | HTTPResponse] = []
        self.server = Server(
            Address("127.0.0.1", 0), Access(token), live_page(), self.board, self.ask
        )
        threading.Thread(target=self.server.serve_forever, args=(0.05,), daemon=True).start()

    def ask(self, kind: str, content: Mapping[str, Any]) -> bool:
        self.asked.append((kind, content))
        return self.recording

    def request(
        self, method: str, path: str, body: bytes | None = None, **headers: str
    ) -> HTTPResponse:
        connection = HTTPConnection("127.0.0.1", self.server.port, timeout=10)
        connection.request(method, path, body, {k.replace("_", "-"): v for k, v in headers.items()})
        answer = connection.getresponse()
        self._opened += [answer, connection]
        return answer

    def close(self) -> None:
        self.board.close()
        for each in self._opened:
            each.close()
        self.server.shutdown()
        self.server.server_close()


@pytest.fixture
def page() -> Iterator[Page]:
    page = Page()
    yield page
    page.close()


@pytest.fixture
def closed_page() -> Iterator[Page]:
    page = Page(TOKEN)
    yield page
    page.close()


def events(stream: HTTPResponse, count: int) -> list[tuple[str, dict[str, Any]]]:
    """The next events of a stream that are no beats."""
    found: list[tuple[str, dict[str, Any]]] = []
    while len(found) < count:
        kind = stream.readline().decode().strip().removeprefix("event: ")
        data = stream.readline().decode().removeprefix("data: ")
        assert stream.readline() == b"\n"
        if kind != "beat":
            found.append((kind, json.loads(data)))
    return found


def test_every_file_of_the_page_is_served_and_asks_for_nothing_elsewhere(page: Page) -> None:
    answer = page.request("GET", "/")
    assert answer.status == 200 and answer.headers["Content-Type"].startswith("text/html")
    assert "default-src 'none'" in answer.headers["Content-Security-Policy"]
    assert {"/index.html", "/live.css", "/main.js", "/page.css", "/connection.js"} <= set(
        live_page().files
    )
    for path, (kind, content) in live_page().files.items():
        answer = page.request("GET", path)
        assert answer.status == 200 and answer.read() == content
        assert answer.headers["Content-Type"].startswith(kind)
        for elsewhere in (b"http://", b"https://", b"//cdn"):
            assert elsewhere not in content
    assert page.request("GET", "/../server.py").status == 404
    assert page.request("GET", "/picture").status == 404


def test_the_stream_begins_with_what_there_is_and_goes_on_with_what_is_new(page: Page) -> None:
    page.board.put("drive", Message("drive", {"unit": "m"}))
    page.board.put("state", Message("state", {"level": "good", "text": "Recording."}))
    stream = page.request("GET", "/stream")
    assert stream.headers["Content-Type"] == "text/event-stream"
    assert events(stream, 2) == [
        ("drive", {"unit": "m"}),
        ("state", {"level": "good", "text": "Recording."}),
    ]
    page.board.put("pose", Message("pose", {"x": 1.5}))
    assert events(stream, 1) == [("pose", {"x": 1.5})]


def test_pictures_are_small_and_keep_the_size_of_their_pixels(page: Page) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (72, 128, 3), np.uint8)
    large = cv2.resize(noise, (1920, 1080))
    data = cv2.imencode(".jpg", large)[1].tobytes()
    page.board.put("broken", Message("broken", {"t_ns": 1}, b"no picture"))
    page.board.put("primary", Message("primary", {"t_ns": 7, "moves": [[1, 2, 3, 4]]}, data))
    ((kind, content),) = events(page.request("GET", "/stream"), 1)
    assert kind == "primary" and content["moves"] == [[1, 2, 3, 4]]
    assert (content["width"], content["height"]) == (1920, 1080)
    assert content["src"].startswith("data:image/jpeg;base64,") and len(content["src"]) < 90_000


def test_more_pages_than_fit_are_refused(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    page.server.streams = threading.BoundedSemaphore(1)
    first = page.request("GET", "/stream")
    assert first.status == 200
    assert page.request("GET", "/stream").status == 503


def test_buttons_reach_the_recording(page: Page) -> None:
    body = json.dumps({"text": "tram"}).encode()
    assert page.request("POST", "/event", body, X_Calm_Edge="page").status == 202
    assert page.request("POST", "/keep", b'{"kept": true}', X_Calm_Edge="page").status == 202
    assert page.asked == [("event", {"text": "tram"}), ("keep", {"kept": True})]
    page.recording = False
    assert page.request("POST", "/event", body, X_Calm_Edge="page").status == 503


def test_other_requests_are_refused(page: Page) -> None:
    # of another site, which cannot set the header
    assert page.request("POST", "/event", b"{}").status == 403
    for path, body in (
        ("/other", b"{}"),
        ("/event", b"no json"),
        ("/event", b"[1]"),
        ("/event", b"x" * (server_module.BODY_BYTES + 1)),
    ):
        assert page.request("POST", path, body, X_Calm_Edge="page").status == 400
    assert page.request("GET", "/", Host="evil.example").status == 403
    assert (
        page.request("POST", "/event", b"{}", X_Calm_Edge="page", Host="evil.example").status == 403
    )
    assert page.request("PUT", "/event", b"{}").status == 501
    assert page.asked == []


def test_a_token_is_required_and_moves_from_the_address_to_a_cookie(closed_page: Page) -> None:
    page = closed_page
    for path in ("/", "/stream", "/main.js", "/?token=wrong-token", "/?token=%C3%BC"):
        answer = page.request("GET", path)
        assert answer.status == 401 and b"calm-edge live printed" in answer.read()
    assert page.request("POST", "/event", b"{}", X_Calm_Edge="page").status == 401
    answer = page.request("GET", f"/?token={TOKEN}")
    assert answer.status == 303 and answer.headers["Location"] == "/"
    cookie = answer.headers["Set-Cookie"]
    assert cookie.startswith(f"{COOKIE}={TOKEN};") and "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    sent = f"{COOKIE}={TOKEN}"
    assert page.request("GET", "/", Cookie=sent, Host="192.168.4.1:8600").status == 200
    assert page.request("POST", "/event", b"{}", X_Calm_Edge="page", Cookie=sent).status == 202
    assert page.request("GET", "/", Cookie=f"{COOKIE}=wrong").status == 401


def test_an_address_in_use_is_refused_in_one_line(page: Page) -> None:
    taken = Address("127.0.0.1", page.server.port)
    with pytest.raises(ConfigError, match="choose an address of this computer and another port"):
        Server(taken, Access(), live_page(), Board(), page.ask)
