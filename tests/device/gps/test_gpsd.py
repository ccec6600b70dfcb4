"""gpsd's JSON protocol, spoken by a small server."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from device.errors import GpsError
from device.gps import reception
from device.gps.fix import FixKind
from device.gps.gpsd import Gpsd, parse_address, report

TPV = {
    "class": "TPV", "mode": 3, "status": 2, "time": "2023-11-14T22:13:20.250Z", "lat": 48.5,
    "lon": 11.25, "altHAE": 520.0, "alt": 473.0, "epx": 2.0, "epy": 3.0, "epv": 5.0,
}  # fmt: skip


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.01)


class Server:
    """Accepts connections and sends them what it is given."""

    def __init__(self) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"gpsd:127.0.0.1:{self._listener.getsockname()[1]}"
        self.clients: list[socket.socket] = []
        self.asked = b""
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self.asked = client.recv(100)
            self.clients.append(client)

    def send(self, *messages: Any) -> None:
        text = "".join(m if isinstance(m, str) else json.dumps(m) + "\r\n" for m in messages)
        self.clients[-1].sendall(text.encode())

    def close(self) -> None:
        for client in self.clients:
            client.close()
        self._listener.close()


@pytest.fixture
def server() -> Iterator[Server]:
    found = Server()
    yield found
    found.close()


def test_reports_are_fixes_and_a_lost_connection_is_made_again(
    server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reception, "SILENT_S", 0.3)
    gps = Gpsd(server.address, lambda: 77, retry_s=0.05)
    gps.start()
    try:
        until(lambda: bool(server.clients))
        assert b'"json":true' in server.asked
        sky = {"class": "SKY", "hdop": 0.8, "uSat": 9}
        server.send({"class": "VERSION"}, "garbage\n", sky, TPV, TPV | {"mode": 1})
        found: list[Any] = []
        until(lambda: bool(found.extend(gps.take(0)) or len(found) == 2))
        assert found[0].t_ns == 77 and found[0].kind is FixKind.DIFFERENTIAL
        assert found[0].sigma_m == (2.0, 3.0, 5.0) and found[0].hdop == 0.8
        assert not found[1].has_position and gps.fault == ""
        until(lambda: "sends nothing" in gps.fault)
        server.clients[-1].close()
        until(lambda: len(server.clients) == 2)
        until(lambda: gps.fault == "")
    finally:
        gps.stop()


def test_without_gpsd_the_fault_names_its_address() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    gps = Gpsd(f"gpsd:127.0.0.1:{port}", lambda: 0, retry_s=0.05)
    gps.start()
    until(lambda: gps.fault != "")
    assert f"gpsd 127.0.0.1:{port}" in gps.fault and gps.take(0) == []
    gps.stop()


def test_a_report_without_errors_has_sigmas_by_its_dilution() -> None:
    bare = {k: v for k, v in TPV.items() if not k.startswith("ep") and k != "altHAE"}
    fix = report(bare, {"hdop": 2.0, "vdop": 3.0}, 0)
    assert fix.utc_ns == 1_700_000_000_250_000_000 and fix.lla == (48.5, 11.25, 473.0)
    assert fix.sigma_m == pytest.approx((1.5 * 2 / 2**0.5,) * 2 + (4.5,)) and not fix.measured


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("gpsd", "localhost", 2947), ("gpsd:car", "car", 2947), ("gpsd:10.0.0.2:99", "10.0.0.2", 99)],
)
def test_addresses(text: str, host: str, port: int) -> None:
    assert parse_address(text) == (host, port)


@pytest.mark.parametrize("text", ["gpsd:car:x", "gpsd:car:99999", "gpsx"])
def test_other_addresses_are_refused(text: str) -> None:
    with pytest.raises(GpsError, match="expected gpsd"):
        parse_address(text)
