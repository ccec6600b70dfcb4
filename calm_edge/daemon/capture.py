"""Main loop of the capture process: passes frames from the cameras to the hub, at a fixed rate.

It never waits for a solver and does not import gtsam: tracker and estimator are child processes.
"""

from __future__ import annotations

import gc
import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from calm_edge.daemon import finish
from calm_edge.daemon.camera_notes import CameraNotes
from calm_edge.daemon.hub import DaemonError, Hub
from calm_edge.daemon.monitor import Monitor
from calm_edge.daemon.result import RecordResult
from calm_edge.types import CalmEdgeError
from device import realtime
from device.camera import Camera, refuse_same_device
from device.camera_thread import CameraState, CameraThread
from device.clock import RateKeeper, SystemClock
from device.errors import DeviceError
from device.frame import Frame
from device.service import Notifier

# Rate of the capture loop. On average it delays a pose by one period: half of it until the frame is
# read, and half until the pose is passed on.
TICK_HZ = 100.0
# Switch interval of the interpreter (sys.setswitchinterval); the default is half a loop period.
SWITCH_S = 0.0005


class Capture:
    """Capture loop of one run of `record`, until the frames end or a stop is requested."""

    def __init__(self, hub: Hub, notifier: Notifier) -> None:
        self._hub, self._notifier = hub, notifier
        self._source, self._lockstep = hub.source, hub.lockstep
        self._cameras: tuple[Camera, ...] = ()
        self._stop_requests = 0
        self._monitor = Monitor(hub.config, notifier, hub.outputs)

    def request_stop(self) -> None:
        """Stop capturing and solve the remaining windows; at a second call, leave them to `map`.

        Called from a signal handler.
        """
        self._stop_requests += 1
        self._hub.impatient = self._stop_requests > 1

    def run(self) -> RecordResult:
        """Run until the frames end or a stop is requested, then close everything; return counts.

        Raises CalmEdgeError, DeviceError.
        """
        hub = self._hub
        try:
            hub.start()
            self._cameras = self._source.open()
            if self._lockstep:
                self._run_lockstep()
            else:
                with low_latency():
                    self._run_realtime()
            # a receiver that is read no more would count as silent
            hub.result.sensor_faults = [s.fault for s in self._source.sensors if s.fault]
            self._monitor.stop(self._source.clock.now_ns())
            self._finish()
        except (CalmEdgeError, DeviceError) as error:
            hub.result.error = str(error)
            raise
        finally:
            stats = [camera.stats() for camera in self._cameras]
            hub.result.camera_drops = sum(each.drops for each in stats)
            corrupt = sum(each.corrupt for each in stats)
            if self._source.is_replay:
                hub.result.unreadable += corrupt
            else:
                hub.result.corrupt = corrupt
            for sensor in self._source.sensors:
                sensor.stop()
            hub.result.clamped_stamps = sum(each.clamped for each in stats)
            hub.result.host_stamped = sum(each.host_stamped for each in stats)
            hub.stop()
        return hub.result

    def _run_lockstep(self) -> None:
        """Track every frame and solve every window before the next frame is read."""
        for sensor in self._source.sensors:
            sensor.start()
        for camera in self._cameras:
            camera.start()
        self._hub.recording.open()
        self._say_notes()
        self._notifier.ready()
        for frame in merged(self._cameras):
            self._hub.take_samples()
            self._hub.frame(frame)
            self._hub.until(self._hub.quiet, math.inf)
            if self._stop_requests:
                break
        for camera in self._cameras:
            camera.stop()

    def _run_realtime(self) -> None:
        hub, monitor = self._hub, self._monitor
        priority = hub.config.capture.realtime_priority
        threads = [CameraThread(camera, realtime_priority=priority) for camera in self._cameras]
        for thread in threads:
            thread.start()
        refuse_same_device(self._cameras)
        # takes a while; frames that arrive meanwhile are queued by the camera threads
        hub.recording.open()
        for sensor in self._source.sensors:
            sensor.start()
        self._say_notes()
        monitor.watch(threads)
        notes = CameraNotes(
            self._cameras,
            lambda settings: hub.outputs.give(lambda output: output.cameras(settings)),
            hub.say,
        )
        notes.update(self._source.clock.now_ns())
        # only now, since this starts systemd's watchdog: opening a camera may exceed its interval
        self._notifier.ready()
        refused = realtime.request(priority)
        if refused:
            hub.say(refused)
        errors: set[str] = set()
        keeper = RateKeeper(SystemClock(), TICK_HZ)
        while not self._stop_requests:
            # read before draining, so that the last frames of a thread that ends now are not missed
            running = [t.state is CameraState.RUNNING for t in threads]
            hub.take_samples()
            with monitor.timed("frames"):
                frames = self._drain(threads)
            with monitor.timed("poses"):
                poses = hub.pump()
            if poses + frames:
                self._notifier.watchdog()
            for thread in threads:
                if thread.error is not None and thread.error not in errors:
                    errors.add(thread.error)
                    if self._source.is_replay:
                        hub.result.error = thread.error
                    else:
                        hub.say(thread.error)
            if monitor.due():
                notes.update(self._source.clock.now_ns())
                shed = monitor.update(hub.take_status(), keeper.lagging, keeper.skipped)
                hub.leave_out(*shed)
            if not any(running) or hub.result.error:
                break
            monitor.latency.add(keeper.wait())
        for thread in threads:
            thread.stop()
        self._drain(threads)
        if hub.result.error:
            raise DaemonError(hub.result.error)
        hub.result.overflowed = sum(t.overflow for t in threads)
        hub.result.late_ticks = keeper.skipped
        hub.result.tick = monitor.latency.overall()

    def _say_notes(self) -> None:
        for note in self._source.notes:
            self._hub.say(note)

    def _drain(self, threads: list[CameraThread]) -> int:
        """Pass the frames queued by the camera threads on, by stamp; return their number."""
        frames = sorted((f for t in threads for f in t.drain()), key=lambda f: (f.t_ns, f.eye))
        for frame in frames:
            self._hub.frame(frame)
        return len(frames)

    def _finish(self) -> None:
        """Wait for the tracker's last windows, for their solutions, and for the joint optimum."""
        hub = self._hub
        hub.capturing = False
        if self._lockstep:
            limit_s = math.inf
        elif self._source.is_replay and not self._stop_requests:
            limit_s = finish.REPLAY_LIMIT_S
        else:
            limit_s = finish.LIVE_LIMIT_S
        if self._stop_requests and not hub.impatient and hub.estimator.waiting:
            hub.say_to_user(
                f"stopping: {hub.estimator.waiting} windows left to solve; interrupt again to "
                "leave them to calm-edge map"
            )
        # one limit for all waits below: systemd kills a service that stops too slowly
        end_s = time.monotonic() + limit_s
        tracker, estimator = hub.tracker, hub.estimator
        hub.until(lambda: not tracker.in_flight, end_s)
        tracker.flush()
        hub.until(lambda: tracker.flushed, end_s)
        hub.until(hub.quiet, end_s, "finishing")
        if estimator.given_up or estimator.waiting:
            return
        estimator.finish()
        hub.until(lambda: estimator.finished is not None or estimator.given_up, end_s, "optimising")
        if estimator.finished is not None:
            hub.result.trajectory = estimator.finished.trajectory
            hub.result.finished = estimator.finished.trajectory is not None
            hub.result.submaps += estimator.solved_late
            hub.result.metre = estimator.finished.metre
            hub.result.gaps = finish.gaps(estimator.finished, hub.config)
            for update in finish.final_updates(estimator.finished):
                hub.give_update(update)


@contextmanager
def low_latency() -> Iterator[None]:
    """Context in which Python's interpreter lock and garbage collector delay a thread less.

    The lock is passed on after SWITCH_S. The collector ignores all objects that exist already
    (gc.freeze), since traversing them takes a tenth of a second.
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
    """Yield the stored frames of both cameras by stamp; at equal stamps the primary's first."""
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
