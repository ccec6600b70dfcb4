"""Test 5: `record` feeds the watchdog, stops on SIGTERM, and is restarted after a hang."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Iterator
from itertools import pairwise

from hil_tests.daemon import Daemon, recording
from hil_tests.kit import Kit
from hil_tests.report import Row, judged, skipped

NAME = "5 watchdog"
# as in deploy/calm-edge.service
WATCHDOG_S = 4.0
STOP_LIMIT_S = 60.0
START_LIMIT_S = 60.0
RUN_S = 20.0
BACK_S = 10.0
UNIT = "calm-edge.service"


def rows(kit: Kit) -> Iterator[Row]:
    """Yield READY, watchdog and SIGTERM; then the restart of the installed service, if it runs."""
    absent = kit.absent()
    if absent:
        yield skipped(NAME, "daemon", absent)
    else:
        with recording(kit, "watchdog", WATCHDOG_S) as daemon:
            yield from of_daemon(daemon)
    yield from of_service()


def of_daemon(daemon: Daemon) -> Iterator[Row]:
    """Yield what a stand-in for systemd receives from the daemon."""
    if not daemon.ready_within(START_LIMIT_S):
        yield judged(NAME, "READY", False, daemon.last_line(), f"within {START_LIMIT_S:g} s")
        return
    ready_s = daemon.times("READY=1")[0]
    yield judged(NAME, "READY", True, f"after {ready_s:.1f} s", f"within {START_LIMIT_S:g} s")
    alive = daemon.listen(RUN_S)
    fed = [ready_s, *daemon.times("WATCHDOG=1")]
    gap_s = max(b - a for a, b in pairwise(fed)) if len(fed) > 1 else RUN_S
    text = f"{len(fed) - 1} times, longest gap {gap_s:.2f} s"
    yield judged(NAME, "fed", gap_s < WATCHDOG_S / 2, text, f"a gap under {WATCHDOG_S / 2:g} s")
    status = [text for _, text in daemon.received if text.startswith("STATUS=")]
    text = status[-1].removeprefix("STATUS=") if status else "nothing"
    yield judged(NAME, "STATUS", bool(status), text, "a line")
    if not alive:
        yield skipped(NAME, "SIGTERM", f"it had ended by itself: {daemon.last_line()}")
        return
    code, took_s = daemon.stop(STOP_LIMIT_S)
    parts = list(daemon.out.glob("*.part"))
    text = f"exit {code} after {took_s:.1f} s, {len(parts)} segment left open"
    wanted = f"exit 0 or 3 within {STOP_LIMIT_S:g} s, none left open"
    yield judged(NAME, "SIGTERM", code in (0, 3) and not parts, text, wanted)


def systemctl(*words: str) -> str:
    command = ["systemctl", *words]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    except OSError:
        return ""


def of_service() -> Iterator[Row]:
    """Yield how long systemd takes to replace a stopped capture process."""
    if os.geteuid() or systemctl("is-active", UNIT) != "active":
        yield skipped(NAME, "restart", f"needs root and a running {UNIT}")
        return
    before = int(systemctl("show", "-P", "MainPID", UNIT))
    started = time.monotonic()
    os.kill(before, signal.SIGSTOP)
    while time.monotonic() - started < 3 * BACK_S:
        now = int(systemctl("show", "-P", "MainPID", UNIT) or 0)
        if now not in (0, before):
            break
        time.sleep(0.1)
    took_s = time.monotonic() - started
    back = now not in (0, before)
    text = f"a new process after {took_s:.1f} s" if back else "not replaced"
    yield judged(NAME, "restart", back and took_s <= BACK_S, text, f"within {BACK_S:g} s")
