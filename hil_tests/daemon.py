"""Run `calm-edge record` with a stand-in for systemd that receives its notifications."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from hil_tests.kit import Kit

PAGE = os.sysconf("SC_PAGE_SIZE")


@dataclass(slots=True)
class Daemon:
    """A running `record`. received: (seconds since the start, message) of each notification."""

    process: subprocess.Popen[str]
    out: Path
    manager: socket.socket
    started_s: float
    received: list[tuple[float, str]] = field(default_factory=list)

    def listen(self, duration_s: float) -> bool:
        """Collect notifications for a while; returns False when the daemon has ended."""
        end = time.monotonic() + duration_s
        while (left_s := end - time.monotonic()) > 0:
            if select.select([self.manager], [], [], min(0.2, left_s))[0]:
                text = self.manager.recv(4096).decode(errors="replace")
                self.received.append((time.monotonic() - self.started_s, text))
            elif self.process.poll() is not None:
                return False
        return True

    def times(self, message: str) -> list[float]:
        """Return when a message was received, in seconds since the start."""
        return [t for t, text in self.received if text.startswith(message)]

    def ready_within(self, limit_s: float) -> bool:
        """Listen until READY=1; returns False if it did not come."""
        end = time.monotonic() + limit_s
        while not self.times("READY=1") and time.monotonic() < end:
            if not self.listen(0.5):
                return False
        return bool(self.times("READY=1"))

    def rss_mib(self) -> float:
        """Return the resident memory of the capture process and its children [MiB]."""
        pids = [self.process.pid]
        for task in Path(f"/proc/{self.process.pid}/task").iterdir():
            try:
                pids += [int(pid) for pid in (task / "children").read_text().split()]
            except OSError:
                continue
        total = 0
        for pid in pids:
            try:
                total += int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE
            except OSError:
                continue
        return total / 2**20

    def stop(self, limit_s: float) -> tuple[int | None, float]:
        """Send SIGTERM; returns the exit status, None if killed, and the seconds taken."""
        before = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        while self.process.poll() is None and time.monotonic() - before < limit_s:
            self.listen(0.2)
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
            return None, limit_s
        return self.process.returncode, time.monotonic() - before

    def last_line(self) -> str:
        """Return the last line that it printed."""
        lines = (self.out.parent / f"{self.out.name}.log").read_text().strip().splitlines()
        return lines[-1] if lines else ""


@contextmanager
def recording(kit: Kit, name: str, watchdog_s: float) -> Iterator[Daemon]:
    """Run `record` with the kit; it is killed at the end if it still runs."""
    kit.out.mkdir(parents=True, exist_ok=True)
    out = Path(tempfile.mkdtemp(prefix=f"{name}-", dir=kit.out)) / "recording"
    log = out.parent / f"{out.name}.log"
    with (
        tempfile.TemporaryDirectory() as place,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager,
        log.open("w") as lines,
    ):
        manager.bind(f"{place}/notify")
        environment = {
            **os.environ,
            "NOTIFY_SOCKET": f"{place}/notify",
            "WATCHDOG_USEC": str(int(watchdog_s * 1e6)),
        }
        environment.pop("WATCHDOG_PID", None)
        process = subprocess.Popen(
            kit.record_command(out), env=environment, stdout=lines, stderr=lines, text=True
        )
        try:
            yield Daemon(process, out, manager, time.monotonic())
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
