from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from device.serial_port import SerialPort


class Line:
    """A pseudo-terminal behind a stable name, as created by udev."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.master = self.slave = -1

    def plug(self) -> None:
        self.master, self.slave = os.openpty()
        os.set_blocking(self.master, False)
        self.name.unlink(missing_ok=True)
        self.name.symlink_to(os.ttyname(self.slave))

    def unplug(self) -> None:
        for fd in (self.master, self.slave):
            if fd >= 0:
                os.close(fd)
        self.master = self.slave = -1
        self.name.unlink(missing_ok=True)

    def read(self) -> bytes:
        data = b""
        with contextlib.suppress(BlockingIOError):
            while chunk := os.read(self.master, 65536):
                data += chunk
        return data


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "tty")
    line.plug()
    yield line
    line.unplug()


@pytest.fixture
def port(line: Line) -> Iterator[SerialPort]:
    port = SerialPort(str(line.name), 115_200, buffer_bytes=1000, retry_s=0.02)
    port.start()
    yield port
    port.stop()


def until(condition: Callable[[], bool]) -> None:
    limit = time.monotonic() + 5
    while not condition():
        assert time.monotonic() < limit
        time.sleep(0.002)


def open_files() -> list[str]:
    """Paths that this process has open."""
    names = []
    for link in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            names.append(str(link.readlink()))
    return names


def test_bytes_arrive_unchanged_and_in_order(line: Line, port: SerialPort) -> None:
    messages = [bytes(range(256))[k : k + 60] for k in (0, 40, 80, 120, 196)]
    for message in messages:
        assert port.write(message)
    until(lambda: port.stats().written == 5)
    assert line.read() == b"".join(messages)
    assert port.connected and port.error is None


def test_a_stalled_receiver_drops_whole_messages_without_blocking(
    line: Line, port: SerialPort
) -> None:
    sent = [b"<%05d" % k + b"." * 90 + b">" for k in range(1000)]
    began = time.monotonic()
    for message in sent:
        assert port.write(message)
    assert time.monotonic() - began < 1
    until(lambda: port.stats().dropped > 0)
    received = b""

    def drained() -> bool:
        nonlocal received
        received += line.read()
        stats = port.stats()
        return stats.written + stats.dropped == 1000 and len(received) == 97 * stats.written

    until(drained)
    arrived = [received[k : k + 97] for k in range(0, len(received), 97)]
    assert set(arrived) <= set(sent) and arrived == sorted(arrived)
    # the oldest were dropped: the newest arrive, as many as the queue holds
    assert arrived[-10:] == sent[-10:]


def test_a_message_larger_than_the_queue_is_rejected(port: SerialPort) -> None:
    assert not port.write(b"x" * 1001)
    assert port.stats().dropped == 1


def test_a_vanished_port_is_reopened(line: Line, port: SerialPort) -> None:
    port.write(b"before")
    until(lambda: port.stats().written == 1)
    tty = os.ttyname(line.slave)
    line.unplug()

    def lost() -> bool:
        port.write(b"into the void")
        return not port.connected

    until(lost)
    until(lambda: "tty" in (port.error or ""))
    assert not {tty, f"{tty} (deleted)"} & set(open_files())
    line.plug()
    until(lambda: port.connected)
    port.write(b"after")
    until(lambda: b"after" in line.read())
    assert port.stats().reconnects == 1 and port.error is None


@pytest.mark.parametrize(("name", "baud"), [("missing", 115_200), ("tty", -5)])
def test_a_port_that_cannot_be_opened_sets_error_without_raising(
    line: Line, name: str, baud: int
) -> None:
    port = SerialPort(str(line.name.with_name(name)), baud, retry_s=0.02)
    port.start()
    until(lambda: port.error is not None)
    assert port.write(b"x")
    assert "cannot be opened" in (port.error or "")
    port.stop()


def test_stop_is_quick_with_a_stalled_receiver(line: Line, port: SerialPort) -> None:
    for _ in range(300):
        port.write(b"x" * 900)
        time.sleep(0.0005)
    began = time.monotonic()
    port.stop()
    port.stop()
    assert time.monotonic() - began < 1
    assert not port.connected
    assert not port.write(b"late")


def test_stop_sends_what_was_written_before(line: Line, port: SerialPort) -> None:
    port.write(b"last words")
    until(lambda: port.stats().written == 1)
    port.stop()
    assert line.read() == b"last words"


def test_received_bytes_are_passed_on_at_once_and_can_be_answered(line: Line) -> None:
    port = SerialPort(str(line.name), 115_200, retry_s=0.02)
    heard: list[bytes] = []

    def answer(data: bytes) -> None:
        heard.append(data)
        port.write(b"<" + data + b">")

    port.start(answer)
    try:
        until(lambda: port.connected)
        # nothing is queued for sending: only received bytes can wake the thread
        os.write(line.master, b"\x00\x03\x11\x13\xff\r\n")
        received = b""

        def answered() -> bool:
            nonlocal received
            received += line.read()
            return received == b"<\x00\x03\x11\x13\xff\r\n>"

        until(answered)
    finally:
        port.stop()
    assert b"".join(heard) == b"\x00\x03\x11\x13\xff\r\n"
    assert port.stats().read == 7


def test_a_sender_that_never_reads_neither_blocks_nor_fills_memory(line: Line) -> None:
    port = SerialPort(str(line.name), 115_200, buffer_bytes=1000, retry_s=0.02)
    port.start(lambda data: port.write(data[:200]))
    try:
        until(lambda: port.connected)
        sent = 0
        while port.stats().dropped < 20:
            with contextlib.suppress(BlockingIOError):
                sent += os.write(line.master, b"blah" * 100)
            assert port._queued_bytes <= 1000
        until(lambda: port.stats().read == sent)
    finally:
        port.stop()


def test_a_vanished_port_is_noticed_with_nothing_to_send(line: Line) -> None:
    port = SerialPort(str(line.name), 115_200, retry_s=0.02)
    port.start()
    try:
        until(lambda: port.connected)
        line.unplug()
        until(lambda: not port.connected)
        line.plug()
        until(lambda: port.connected)
        assert port.stats().reconnects == 1
    finally:
        port.stop()


def test_stop_sends_a_message_queued_just_before(line: Line, port: SerialPort) -> None:
    until(lambda: port.connected)
    for k in range(9):
        port.write(b"%d" % k * 100)
    port.stop()
    assert line.read() == b"".join(b"%d" % k * 100 for k in range(9))
