"""Fault rows in which the real command is killed, stopped or hung."""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from calm_edge.recording import schema
from calm_edge.recording.reader import Recording
from calm_edge.recording.recovery import Outcome, recover, validate
from device.frame import Eye
from tests.faults.independent_reader import independent_counts
from tests.faults.row import Row, sequences

PROJECT = Path(__file__).parents[2]


def unit_seconds(key: str) -> float:
    """Read a time of the service unit."""
    unit = (PROJECT / "deploy" / "calm-edge.service").read_text(encoding="utf-8")
    (value,) = re.findall(rf"^{key}=([\d.]+)$", unit, re.MULTILINE)
    return float(value)


WATCHDOG_S, RESTART_S = unit_seconds("WatchdogSec"), unit_seconds("RestartSec")
STOP_S = unit_seconds("TimeoutStopSec")
# of the small drive
FIRST_STAMP_NS = 10**9


def command(drive: Path, *target: str) -> list[str]:
    """Command line of `calm-edge record` that replays a drive in real time."""
    arguments = ["record", "--sequence", str(drive), "--pace", "realtime", "--spacing-m", "0.5"]
    arguments += ["--set", f"backbone.name=scripted:{drive}", "--set", "frontend.n_max=6"]
    arguments += ["--set", "frontend.n_overlap=2", *target]
    return [sys.executable, "-m", "calm_edge.cli", *arguments]


@contextmanager
def running(drive: Path, *target: str, **environment: str) -> Iterator[subprocess.Popen[str]]:
    """Context with the running command, which is killed at the end."""
    process = subprocess.Popen(
        command(drive, *target),
        cwd=PROJECT,
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()


def wait_for_frames(rec: Path, limit_s: float = 60.0) -> None:
    """Wait until a first frame is in the file; raises TimeoutError."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        if any(rec.glob("*.mcap.part")) and Recording(rec).count("/primary/image"):
            return
        time.sleep(0.05)
    raise TimeoutError(f"{rec}: no frame in {limit_s:.0f} s")


def lost_s(recording: Recording, killed_ns: int) -> dict[str, float]:
    """Seconds of each periodic topic that are missing before the kill, by the host clock.

    The loss begins one period after the newest message. Poses and sub-maps are not periodic: see
    `missing_results`.
    """
    # the replay's clock runs at the rate of the host's, from the first frame on
    *_, pair = recording.json_messages(schema.CLOCK)
    logged = [p.t_ns for p in recording._locations(schema.CLOCK)]
    killed_stamp_ns = killed_ns - pair["monotonic_ns"] + logged[-1]
    lost = {}
    for topic in (*schema.IMAGE_TOPICS.values(), schema.CLOCK, schema.HEALTH):
        times = np.array([p.t_ns for p in recording._locations(topic)], np.int64)
        period_ns = float(np.median(np.diff(times))) if len(times) > 1 else 1e9
        newest = int(times[-1]) if len(times) else FIRST_STAMP_NS
        lost[topic] = max(0.0, (killed_stamp_ns - newest - period_ns) / 1e9)
    return lost


def missing_results(recording: Recording) -> int:
    """Number of poses and sub-maps counted by the newest /health message but not recorded.

    All topics pass one queue in order, so a message before an image is lost only together with it.
    """
    counts = [m["counts"] for m in recording.json_messages(schema.HEALTH)]
    if not counts:
        return 0
    poses = counts[-1]["poses"] + counts[-1]["lost_poses"] - recording.count(schema.POSE_SAMPLE)
    submaps = counts[-1]["submaps"] - recording.count(schema.SUBMAP)
    return max(0, poses) + max(0, submaps)


def kill_9(drive: Path, folder: Path, times: int, longest_s: float, seed: int = 5) -> Row:
    """Kill at random moments after the first frame, recover, count by an independent reader."""
    moment = random.Random(seed)
    worst: dict[str, float] = {}
    agreed = recovered = missing = 0
    reader = ""
    for k in range(times):
        rec = folder / f"rec{k}"
        with running(drive, "--out", str(rec)) as process:
            wait_for_frames(rec)
            time.sleep(moment.uniform(0.0, longest_s))
            process.send_signal(signal.SIGKILL)
            killed_ns = time.monotonic_ns()
            process.wait()
        for topic, seconds in lost_s(Recording(rec), killed_ns).items():
            worst[topic] = max(worst.get(topic, 0.0), seconds)
        missing += missing_results(Recording(rec))
        report = recover(rec, folder / f"recovered{k}")
        ours = Counter(report.messages)
        reader, theirs = independent_counts([rec], PROJECT / "build" / "interop")
        _, again = independent_counts([folder / f"recovered{k}"], PROJECT / "build" / "interop")
        agreed += ours == theirs == again
        recovered += (
            report.outcome is Outcome.WITH_LOSS
            and validate(folder / f"recovered{k}").outcome is Outcome.ALL
        )
    longest = max(worst, key=lambda topic: worst[topic])
    return Row(
        f"kill -9, {times} random moments",
        f"at most {worst[longest]:.2f} s lost ({longest}), {missing} poses and sub-maps before "
        f"that missing; counts equal in {agreed} of {times} "
        f"({reader})",
        "<= 1.5 s lost of every topic; counts equal those of an independent reader",
        worst[longest] <= 1.5 and not missing and agreed == recovered == times,
    )


def terminated(drive: Path, folder: Path, after_s: float = 2.0) -> Row:
    """Send SIGTERM to all processes of the command in the middle of a drive."""
    rec = folder / "rec"
    with running(drive, "--out", str(rec)) as process:
        wait_for_frames(rec)
        time.sleep(after_s)
        started = time.monotonic()
        # of the group that `running` makes
        os.killpg(process.pid, signal.SIGTERM)
        code = process.wait(2 * STOP_S)
        took_s = time.monotonic() - started
    recording = Recording(rec)
    same = all(_unchanged(recording, drive, eye) for eye in Eye)
    outcome = validate(rec).outcome
    *_, status = (s for s in recording.json_messages(schema.STATUS) if "finished" in s)
    finished = status["finished"] and not status["estimator_restarts"]
    return Row(
        "SIGTERM to all processes",
        f"exit {code} after {took_s:.1f} s, validate {int(outcome)}, JPEG bytes "
        f"{'identical' if same else 'changed'}, {status['submaps']} sub-maps, "
        f"poses {'optimised' if finished else 'not optimised'}",
        f"exit 0 or 3 within TimeoutStopSec ({STOP_S:g} s), recording complete, bytes identical, "
        "poses optimised",
        code in (0, 3) and took_s < STOP_S and outcome is Outcome.ALL and same and finished,
    )


def _unchanged(recording: Recording, drive: Path, eye: Eye) -> bool:
    """Whether the frames equal the drive's files from the first on, byte by byte."""
    files = sorted((drive / f"cam{int(eye)}").iterdir())
    frames = list(recording.frames(eye))
    in_order = sequences(recording, eye) == list(range(len(frames)))
    pairs = zip(frames, files, strict=False)
    return len(frames) > 0 and in_order and all(f.image == p.read_bytes() for f, p in pairs)


class ServiceManager:
    """Socket that receives the daemon's messages to systemd."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))

    def wait(self, word: str, limit_s: float) -> bool:
        """Wait for a message that begins with `word`; False after the time limit."""
        end = time.monotonic() + limit_s
        while (left_s := end - time.monotonic()) > 0:
            self._socket.settimeout(left_s)
            try:
                text = self._socket.recv(4096).decode()
            except TimeoutError:
                return False
            if text.startswith(word):
                return True
        return False

    def close(self) -> None:
        self._socket.close()


def hung(drive: Path, folder: Path) -> Row:
    """Stop the capture process; kill and restart it as systemd would with the unit's times."""
    # the path of a socket has a length limit
    place = Path(f"/tmp/calm-edge-notify-{os.getpid()}")
    manager = ServiceManager(place)
    environment = {"NOTIFY_SOCKET": str(place), "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6))}
    target = ("--root", str(folder / "root"))
    ready = silent = False
    try:
        with running(drive, *target, **environment) as process:
            ready = manager.wait("READY=1", 60) and manager.wait("WATCHDOG=1", 20)
            process.send_signal(signal.SIGSTOP)
            hung_s = time.monotonic()
            while manager.wait("WATCHDOG=1", WATCHDOG_S):
                # sent before the hang
                continue
            process.kill()
        time.sleep(RESTART_S)
        with running(drive, *target, **environment):
            silent = manager.wait("WATCHDOG=1", 60)
            back_s = time.monotonic() - hung_s
    finally:
        manager.close()
        place.unlink()
    first, second = sorted((folder / "root").iterdir())
    whole = recover(first, folder / "recovered").outcome is not Outcome.FAILED
    shutil.rmtree(folder / "recovered", ignore_errors=True)
    return Row(
        "capture hangs",
        f"next frame {back_s:.1f} s after the hang (watchdog {WATCHDOG_S:g} s, restart "
        f"{RESTART_S:g} s), into {second.name}",
        "frames again <= 10 s after the hang, in a folder of their own",
        ready and silent and whole and back_s <= 10.0,
    )
