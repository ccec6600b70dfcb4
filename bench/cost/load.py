"""Frame loss, tick jitter and pose age of capture on an overloaded machine.

Replays two 1280x720 JPEG streams at 30 Hz through the real daemon three times, always with more
windows than the estimator can solve. In the second and third run another process optimises a long
graph; in the third the estimator is also killed twice.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2

from bench.cost.load_pictures import EPOCH_NS, RATE_HZ, SIZE, enlarged, frames
from bench.tables import OUT, Check, Table, publish
from calm_edge.config import Config, merge
from calm_edge.daemon.capture import Capture
from calm_edge.daemon.hub import Hub
from calm_edge.daemon.outputs import RecordingOutput
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.source import replayed
from calm_edge.recording.reader import Recording
from calm_edge.recording.schema import IMAGE_TOPICS
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import CalmEdgeError
from device import realtime
from device.frame import Eye
from device.service import NullNotifier

KEYFRAMES = 4500
TICK_MS, AGE_MS, CORE_SHARE = 5.0, 150.0, 0.25
# real-time priority of the capture threads in the package's configuration
PRIORITY = 10
# times at which the estimator is killed, as shares of the run
KILLS = (1 / 3, 2 / 3)


@dataclass(frozen=True, slots=True)
class Run:
    """Measurements of one replay.

    asked, lost: numbers of frames replayed, and of those missing in the recording. core_share,
    tracker_share: processor time of the capture process (with recording) and of the tracker, over
    wall time. load: load average at the end. priority: real-time priority of the capture threads, 0
    for none.
    """

    name: str
    asked: int
    lost: int
    core_share: float
    tracker_share: float
    load: float
    result: RecordResult
    priority: int = 0


class Watch(NullNotifier):
    """Measures the processor time of capture and tracker; kills the estimator at given times."""

    def __init__(self, kill_at_s: list[float]) -> None:
        self._kill_at_s = kill_at_s
        self._began = (0.0, 0.0)
        self.hub: Hub | None = None
        self.core_share = self.tracker_share = 0.0

    def ready(self) -> None:
        self._began = time.monotonic(), time.process_time()

    def watchdog(self) -> None:
        due = self._kill_at_s and time.monotonic() - self._began[0] > self._kill_at_s[0]
        if due and self.hub is not None:
            self._kill_at_s.pop(0)
            os.kill(self.hub.estimator.child.pid, signal.SIGKILL)

    def stopping(self) -> None:
        wall_s, cpu_s = time.monotonic() - self._began[0], time.process_time() - self._began[1]
        self.core_share = cpu_s / wall_s
        if self.hub is not None:
            self.tracker_share = cpu_seconds(self.hub.tracker.child.pid) / wall_s
            # pending windows are not part of the measurement: end without solving them
            self.hub.impatient = True


def granted(priority: int) -> int:
    """Return `priority` if this user may set it as real-time priority, else 0."""
    refused: list[str | None] = []
    # in a thread of its own, since the kernel would keep the priority for this one
    thread = threading.Thread(target=lambda: refused.append(realtime.request(priority)))
    thread.start()
    thread.join()
    return 0 if refused[0] else priority


def cpu_seconds(pid: int) -> float:
    """Processor time of a process, user and system, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def optimising(keyframes: int) -> Iterator[None]:
    """Context in which a child process optimises a graph of `keyframes` again and again.

    Raises CalmEdgeError if the child process does not start, or ends early.
    """
    program = "bench.cost.load_graph"
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, "-m", program, str(keyframes)],
        stdout=subprocess.PIPE,
        env=environment,
    ) as child:
        try:
            assert child.stdout is not None
            if child.stdout.readline() != b"ready\n":
                raise CalmEdgeError(f"{program}: did not start; its own error message is above")
            yield
            if child.poll() is not None:
                raise CalmEdgeError(f"{program}: ended early, exit code {child.returncode}")
        finally:
            child.kill()


def replay(
    name: str,
    pictures: tuple[list[Path], ...],
    seconds: float,
    priority: int,
    kills: tuple[float, ...] = (),
) -> Run:
    """Run the daemon on `seconds` of frames and return its measurements.

    name: title of the run. pictures: files of each eye. kills: times at which the estimator is
    killed, as shares of `seconds`.
    """
    config = merge(
        Config(),
        {
            "scale": {"spacing_m": 0.5},
            # more keyframes, hence more windows than any machine can solve
            "frontend": {"max_keyframe_gap_s": 0.1},
            "capture": {
                "rate_hz": float(RATE_HZ),
                "width_px": SIZE[0],
                "height_px": SIZE[1],
                "realtime_priority": priority,
            },
        },
    )
    count = round(seconds * RATE_HZ)
    source = replayed(
        lambda eye: frames(pictures[eye], eye, count), EPOCH_NS, True, "enlarged drive"
    )
    watch = Watch([share * seconds for share in kills])
    with tempfile.TemporaryDirectory(prefix="calm-edge-load-") as place:
        folder = Path(place) / "recording"
        hub = Hub(
            config,
            source,
            RecordingOutput(lambda: RecordingWriter(folder, config, now_ns=source.clock.now_ns)),
            lockstep=False,
            say=lambda text: print(f"load, {name}: {text}", file=sys.stderr, flush=True),
        )
        watch.hub = hub
        result = Capture(hub, watch).run()
        recording = Recording(folder)
        kept = sum(recording.count(topic) for topic in IMAGE_TOPICS.values())
    load = os.getloadavg()[0]
    shares = watch.core_share, watch.tracker_share
    return Run(name, 2 * count, 2 * count - kept, *shares, load, result, priority)


def table(runs: list[Run], command: str) -> Table:
    """Table with one row for each replay, and the requirements on it."""
    rows, checks = [], []
    for each in runs:
        tick, result = each.result.tick, each.result
        age = result.pose_age_ms() or {"p50": float("inf"), "p99": float("inf")}
        primary = result.frames[Eye.PRIMARY]
        rows.append(
            (
                each.name,
                f"{each.lost} of {each.asked}",
                f"{tick.p50_ms:.2f} / {tick.p99_ms:.2f} / {tick.max_ms:.1f}",
                f"{age['p50']:.0f} / {age['p99']:.0f}",
                f"{result.poses / max(primary, 1):.0%}",
                result.untracked + result.late_poses,
                f"{each.core_share:.2f} + {each.tracker_share:.2f}",
                f"{result.submaps} of {result.windows}",
                result.estimator_restarts,
                round(each.load, 1),
            )
        )
        checks += [
            Check(f"{each.name}: frames lost", "0", each.lost, each.lost == 0),
            Check(
                f"{each.name}: tick lateness p99, ms",
                f"<= {TICK_MS:g}",
                round(tick.p99_ms, 2),
                tick.p99_ms <= TICK_MS,
            ),
            Check(
                f"{each.name}: pose age p99, ms",
                f"<= {AGE_MS:g}",
                round(age["p99"]) if age["p99"] < float("inf") else "no pose",
                age["p99"] <= AGE_MS,
            ),
            Check(
                f"{each.name}: capture and recording, of a core",
                f"<= {CORE_SHARE:g}",
                round(each.core_share, 3),
                each.core_share <= CORE_SHARE,
            ),
        ]
    seconds = runs[0].asked / 2 / RATE_HZ
    notes = (
        f"each run {seconds:.0f} s; the demo drive enlarged to {SIZE[0]}x{SIZE[1]} and "
        f"interpolated to {RATE_HZ} Hz by optical flow, forwards and backwards; a keyframe every "
        "0.1 s, so that the estimator is always busy",
        f"{os.cpu_count()} cores, shared with other load: see the load average; the capture "
        + (
            f"threads at real-time priority {runs[0].priority}, as the package sets it"
            if runs[0].priority
            else "process at ordinary priority, without real-time scheduling"
        ),
        "processor time of the whole capture process: replay, capture, recording",
        "poses: of the primary's frames; not tracked: recorded, but the tracker was behind or the "
        "pose too late",
    )
    columns = (
        "meanwhile",
        "frames lost",
        "tick ms p50/p99/max",
        "pose age ms p50/p99",
        "poses",
        "not tracked",
        "core: capture + tracker",
        "sub-maps",
        "restarts",
        "load",
    )
    return Table(
        "bench_load", "Capture under load", command, columns, tuple(rows), tuple(checks), notes
    )


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command to `parser`."""
    parser.add_argument("--minutes", type=float, default=1.0, help="of each run")
    parser.add_argument("--ordinary", action="store_true", help="no real-time scheduling")
    parser.add_argument("--drive", type=Path, default=Path("demo") / "drive")
    parser.add_argument("--pictures", type=Path, default=Path("build") / "bench_pictures")
    parser.add_argument("--out", type=Path, default=OUT)


def run(options: argparse.Namespace) -> int:
    """Run all three replays, print and save the table; return 0 even if a target is missed."""
    cv2.setNumThreads(1)
    seconds = 60 * options.minutes
    pictures = tuple(enlarged(options.drive, eye, options.pictures) for eye in Eye)
    priority = 0 if options.ordinary else granted(PRIORITY)
    runs = [replay("inference", pictures, seconds, priority)]
    with optimising(KEYFRAMES):
        graph = f"and a graph of {KEYFRAMES} keyframes"
        runs.append(replay(graph, pictures, seconds, priority))
        runs.append(replay("and the estimator killed twice", pictures, seconds, priority, KILLS))
    publish(table(runs, options.command), options.out)
    return 0
