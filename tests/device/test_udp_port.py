"""UDP port, on the loopback: datagrams both ways; absent receivers, names and addresses."""

from __future__ import annotations

import logging
import socket
import time
from collections.abc import Callable, Iterator

import pytest

from device.udp_port import UdpAddressError, UdpPort, parse_udp


@pytest.fixture
def receiver() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.settimeout(5.0)
        yield made


def opened(receiver: socket.socket, received: list[bytes] | None = None) -> UdpPort:
    port = UdpPort(f"udp:127.0.0.1:{receiver.getsockname()[1]}", retry_s=0.02)
    port.start(None if received is None else received.append)
    return port


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.005)


def test_each_message_is_a_datagram_and_answers_arrive(receiver: socket.socket) -> None:
    answers: list[bytes] = []
    port = opened(receiver, answers)
    # from the first one on
    assert all(port.write(message) for message in (b"one", b"two" * 90))
    assert receiver.recv(500) == b"one" and receiver.recv(500) == b"two" * 90
    port.write(b"who")
    data, sender = receiver.recvfrom(500)
    receiver.sendto(b"answer", sender)
    until(lambda: answers == [b"answer"])
    assert port.connected and port.error is None
    stats = port.stats()
    assert (stats.written, stats.dropped, stats.read) == (3, 0, 6) and data == b"who"
    port.stop()
    port.stop()
    assert not port.write(b"late") and port.stats().dropped == 1


def test_nobody_listens_until_somebody_does(
    receiver: socket.socket, caplog: pytest.LogCaptureFixture
) -> None:
    number = receiver.getsockname()[1]
    receiver.close()
    port = UdpPort(f"udp:127.0.0.1:{number}", retry_s=0.02)
    with caplog.at_level(logging.WARNING):
        port.start()
        until(lambda: not (port.write(b"lost") and port.error is None) and port.error is not None)
    assert port.error == f"udp:127.0.0.1:{number}: nobody listens there"
    assert [r for r in caplog.records if "nobody listens" in r.getMessage()]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
        late.bind(("127.0.0.1", number))
        late.settimeout(5.0)
        port.write(b"found")
        port.write(b"found")
        assert late.recv(500) == b"found"
        until(lambda: port.error is None and port.connected)
    port.stop()


def test_a_name_that_cannot_be_resolved_is_reported_and_tried_again(
    monkeypatch: pytest.MonkeyPatch, receiver: socket.socket
) -> None:
    resolve, known = socket.getaddrinfo, list[bool]()

    def resolved(host: str, *arguments: object, **options: object) -> object:
        if host == "autopilot" and not known:
            raise socket.gaierror(-2, "Name or service not known")
        return resolve("127.0.0.1", *arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(socket, "getaddrinfo", resolved)
    port = UdpPort(f"udp:autopilot:{receiver.getsockname()[1]}", retry_s=0.02)
    port.start()
    until(lambda: port.error is not None)
    assert "cannot be used (Name or service not known)" in (port.error or "")
    assert not port.write(b"lost")
    known.append(True)
    until(lambda: port.connected)
    assert port.write(b"found") and receiver.recv(500) == b"found"
    port.stop()


@pytest.mark.parametrize(
    ("text", "parsed"),
    [
        ("udp:192.168.1.10:14550", ("192.168.1.10", 14550)),
        ("udp:autopilot.local:1", ("autopilot.local", 1)),
        ("udp:[::1]:14550", ("::1", 14550)),
    ],
)
def test_addresses(text: str, parsed: tuple[str, int]) -> None:
    assert parse_udp(text) == parsed


@pytest.mark.parametrize(
    "text",
    ["udp:", "udp:host", "udp::14550", "udp:host:0", "udp:host:65536", "udp:host:x", "udp:::1:5"],
)
def test_a_wrong_address_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(UdpAddressError, match=r"expected udp:HOST:PORT, e\.g\. udp:192"):
        UdpPort(text)
