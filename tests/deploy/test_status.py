"""What `systemctl status` shows of a service that cannot start."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from calm_edge.cli import main


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[capture]\nprimary = 'nosuch:1'\n", "unknown driver 'nosuch'"),
        ("[capture]\nprimry = 'v4l2:'\n", "capture.primry: no such key"),
    ],
)
def test_the_reason_of_a_failed_start_is_the_status(
    text: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("systemd.daemon")
    config = tmp_path / "calm-edge.toml"
    config.write_text(text)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(2)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        assert main(["record", "--config", str(config), "--root", str(tmp_path / "root")]) == 1
        received = manager.recv(4096).decode()
    assert received.startswith("STATUS=FAILED: ") and reason in received


def test_a_start_without_cameras_leaves_no_empty_drive(tmp_path: Path) -> None:
    address = "v4l2:usb-that-is-not-there"
    addresses = [f"capture.{eye}={address}" for eye in ("primary", "assistant")]
    arguments = ["record", "--root", str(tmp_path / "root")]
    assert main([*arguments, "--set", addresses[0], "--set", addresses[1]]) == 1
    assert list((tmp_path / "root").glob("*")) == []
