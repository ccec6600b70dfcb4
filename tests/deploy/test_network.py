"""Nothing listens: no process of a running `record` holds an internet socket."""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path

from calm_edge.daemon.hub import Hub
from tests.replay.daemon_run import record
from tests.replay.small_drive import write_drive

TABLES = ("tcp", "tcp6", "udp", "udp6", "udplite", "udplite6", "raw", "raw6", "packet")
INODE_COLUMN = {"packet": 8}


def network_sockets(pids: list[int]) -> dict[int, set[str]]:
    """Inodes of the sockets of each process that are in one of the kernel's network tables."""
    known: set[str] = set()
    for table in TABLES:
        path = Path("/proc/net") / table
        if path.exists():
            rows = [line.split() for line in path.read_text().splitlines()[1:]]
            known |= {row[INODE_COLUMN.get(table, 9)] for row in rows}
    return {pid: sockets(pid) & known for pid in pids}


def sockets(pid: int) -> set[str]:
    found = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        try:
            match = re.fullmatch(r"socket:\[(\d+)\]", str(fd.readlink()))
        except OSError:
            continue
        if match:
            found.add(match[1])
    return found


def test_a_running_record_has_no_socket_that_a_network_could_reach(
    tmp_path: Path,
) -> None:
    seen: dict[int, set[str]] = {}

    def look(hub: Hub, _: str) -> None:
        if hub.result.submaps and not seen:
            children = [hub.tracker.child, hub.estimator.child]
            seen.update(network_sockets([os.getpid(), *(c.pid for c in children if c)]))

    before = network_sockets([os.getpid()])[os.getpid()]
    record(write_drive(tmp_path / "drive"), tmp_path / "rec", lockstep=False, during=look)
    assert len(seen) == 3
    assert set().union(*seen.values()) <= before


def test_a_listening_socket_would_have_been_seen() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        inode = str(os.fstat(server.fileno()).st_ino)
        assert inode in network_sockets([os.getpid()])[os.getpid()]
