"""The capture process: cameras in, recording and poses out, at a fixed rate, whatever happens.

It never imports gtsam and never runs a solver: tracker and estimator are processes of their own.
"""

from __future__ import annotations

import gc
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from calm_edge.daemon import finale
from calm_edge.daemon.monitor import Monitor, SerialLine
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.switchboard import Switchboard
from device import realtime
from device.camera import Camera
from device.camera_thread import CameraState, CameraThread
from device.clock import RateKeeper, SystemClock
from device.frame import Frame
from device.service import Notifier

# a pose waits half a tick on its way in and half a tick on its way out
TICK_HZ = 100.0
# a thread that waits for the interpreter gets it after this long; by default 5 ms, half a tick
SWITCH_S = 0.0005


class Capture:
    """Owner of one run of `record`."""

    def __init__(
        self, desk: Switchboard, notifier: Notifier, serial: SerialLine | None = None
    ) -> None:
        self._desk, self._notifier = desk, notifier
        self._source, self._lockstep = desk.source, desk.lockstep
        self._cameras: tuple[Camera, ...] = ()
        self._stop_requests = 0
        self._monitor = Monitor(desk, notifier, serial)

    def request_stop(self) -> None:
        """From a signal handler: finish soon; a second time: at once."""
        self._stop_requests += 1
        self._desk.impatient = self._stop_requests > 1

    def run(self) -> RecordResult:
        """Until the frames end or a stop is requested; raises CalmEdgeError, after closing."""
        try:
            self._desk.start()
            self._cameras = self._source.open()
            if self._lockstep:
                self._run_lockstep()
            else:
                with prompt():
                    self._run_realtime()
            self._monitor.stop()
            self._finish()
        finally:
            self._desk.stop()
            self._close()
        return self._desk.result

    def _run_lockstep(self) -> None:
        """Every frame is tracked, and every window solved, before the next frame is read."""
        for camera in self._cameras:
            camera.start()
        self._desk.open_recording()
        self._notifier.ready()
        for frame in merged(self._cameras):
            self._desk.frame(frame)
            self._desk.until(self._desk.quiet, math.inf)
            if self._stop_requests:
                break
        for camera in self._cameras:
            camera.stop()

    def _run_realtime(self) -> None:
        priority = self._desk.config.capture.realtime_priority
        threads = [CameraThread(camera, realtime_priority=priority) for camera in self._cameras]
        for thread in threads:
            thread.start()
        # the first frames wait in the threads for this
        self._desk.open_recording()
        self._monitor.watch(threads)
        # the watchdog runs from here on, and opening a camera may take longer than it waits
        self._notifier.ready()
        refused = realtime.request(priority)
        if refused:
            self._desk.say(refused)
        said: set[str] = set()
        keeper = RateKeeper(SystemClock(), TICK_HZ)
        while not self._stop_requests:
            # asked before draining: what a finished thread left behind is drained below
            running = [t.state is CameraState.RUNNING for t in threads]
            with self._monitor.timed("frames"):
                frames = self._drain(threads)
            with self._monitor.timed("poses"):
                poses = self._desk.pump()
            if poses + frames:
                self._notifier.watchdog()
            for thread in threads:
                if thread.error is not None and thread.error not in said:
                    said.add(thread.error)
                    if self._source.is_replay:
                        self._desk.result.error = thread.error
                    else:
                        self._desk.say(thread.error)
            self._monitor.look(keeper.lagging, keeper.skipped)
            if not any(running) or self._desk.result.error:
                break
            self._monitor.lateness.note(keeper.wait())
        for thread in threads:
            thread.stop()
        self._drain(threads)
        self._desk.result.overflowed = sum(t.overflow for t in threads)
        self._desk.result.late_ticks = keeper.skipped
        self._desk.result.tick = self._monitor.lateness.overall()

    def _drain(self, threads: list[CameraThread]) -> int:
        """Every frame that came since the last time, in order; how many."""
        frames = sorted((f for t in threads for f in t.drain()), key=lambda f: (f.t_ns, f.eye))
        for frame in frames:
            self._desk.frame(frame)
        return len(frames)

    def _finish(self) -> None:
        """The last windows, the backlog, the joint optimum."""
        self._desk.capturing = False
        if self._lockstep:
            limit_s = math.inf
        elif self._source.is_replay and not self._stop_requests:
            limit_s = finale.REPLAY_LIMIT_S
        else:
            limit_s = finale.LIVE_LIMIT_S
        # one limit for all of it: whoever stopped us waits only so long before it kills
        end_s = time.monotonic() + limit_s
        tracker = self._desk.tracker
        self._desk.until(lambda: not tracker.in_flight, end_s)
        tracker.flush()
        self._desk.until(lambda: tracker.flushed, end_s)
        self._desk.until(self._desk.quiet, end_s, "finishing")
        if self._desk.estimator.given_up or self._desk.estimator.waiting:
            return
        self._desk.estimator.finish()
        link = self._desk.estimator
        self._desk.until(lambda: link.finished is not None or link.given_up, end_s, "optimising")
        if link.finished is not None:
            self._desk.result.trajectory = link.finished.trajectory
            for update in finale.final_updates(link.finished, self._desk.kit):
                self._desk.recording.write_update(update)

    def _close(self) -> None:
        result, link = self._desk.result, self._desk.estimator
        result.lost_windows = sorted(link.lost)
        result.windows_left_to_map = sorted(link.left_to_map)
        result.unsolved_windows = sorted(link.unsolved)
        result.estimator_restarts = link.restarts
        result.tracker_restarts = self._desk.tracker.restarts
        result.untracked += self._desk.tracker.frames_lost
        result.camera_drops = sum(c.stats().drops for c in self._cameras)
        result.clamped_stamps = sum(c.stats().clamped for c in self._cameras)
        if self._desk.writer is None:
            return
        self._desk.writer.write_status(result.summary())
        health = self._desk.writer.close()
        result.unrecorded = health.dropped_images + health.dropped_others + health.unwritable
        if health.error:
            result.error = result.error or health.error


@contextmanager
def prompt() -> Iterator[None]:
    """The loop need not wait for the other threads of this process longer than SWITCH_S, nor for
    a search through all that was there before it for what could be freed: a tenth of a second.
    """
    before = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH_S)
    gc.collect()
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(before)


def merged(cameras: tuple[Camera, ...]) -> Iterator[Frame]:
    """Frames of both unpaced cameras in the order of their stamps, the primary first."""
    heads = [camera.read(0.0) for camera in cameras]
    while any(head is not None for head in heads):
        eye = min(
            (i for i, head in enumerate(heads) if head is not None),
            key=lambda i: (heads[i].t_ns, i),  # type: ignore[union-attr]
        )
        frame = heads[eye]
        heads[eye] = cameras[eye].read(0.0)
        assert frame is not None
        yield frame
