"""The pose output: a port that cannot be used is a loss at the end, on a serial line and by UDP."""

from __future__ import annotations

import socket
import time
from pathlib import Path

import pytest

from calm_edge.config import Config, ConfigError, merge
from calm_edge.daemon.fan_out import FanOut
from calm_edge.daemon.outputs import configured
from calm_edge.daemon.result import RecordResult
from device.udp_port import UdpAddressError


def of_port(port: str, **more: object) -> Config:
    return merge(Config(), {"pose_output": {"port": port, **more}, "scale": {"spacing_m": 0.5}})


def closed(port: str) -> RecordResult:
    """Result of a run with a pose output, which sends its state at least."""
    outputs = FanOut(configured(of_port(port), time.monotonic_ns))
    for _ in range(4):
        outputs.tick(time.monotonic_ns())
        time.sleep(0.05)
    result = RecordResult(frames=[1, 1])
    outputs.close(result)
    return result


def test_a_serial_port_that_cannot_be_opened_is_a_loss(tmp_path: Path) -> None:
    result = closed(str(tmp_path / "ttyUSB9"))
    assert any(
        line.startswith("output: ") and "ttyUSB9: cannot be opened" in line
        for line in result.losses()
    )
    # the messages that waited for it are counted
    assert result.output_losses["serial"] >= 2


def test_a_udp_port_where_nobody_listens_is_a_loss() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        number = taken.getsockname()[1]
    result = closed(f"udp:127.0.0.1:{number}")
    assert any("nobody listens there" in line for line in result.losses())


def test_messages_arrive_by_udp_and_baud_does_not_limit_them() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far:
        far.bind(("127.0.0.1", 0))
        far.settimeout(5.0)
        result = closed(f"udp:127.0.0.1:{far.getsockname()[1]}")
        assert far.recv(500)[0] == 0xFD  # the first byte of MAVLink 2
    assert not any(line.startswith("output: ") for line in result.losses())
    assert configured(of_port("udp:127.0.0.1:9", rate_hz=200.0), time.monotonic_ns)
    with pytest.raises(ConfigError, match=r"poses per second"):
        configured(of_port("/dev/ttyUSB9", rate_hz=200.0), time.monotonic_ns)
    with pytest.raises(UdpAddressError, match=r"udp:HOST:PORT"):
        configured(of_port("udp:14550"), time.monotonic_ns)
