"""Capture's desk: frames go out to tracker and estimator, what they say comes back in order."""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from calm_edge.config import Config
from calm_edge.daemon.child import Child
from calm_edge.daemon.estimator_link import EstimatorLink
from calm_edge.daemon.ladder import Shed
from calm_edge.daemon.messages import Attached, Posed, Tracked
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.source import Source
from calm_edge.daemon.tracker_link import TrackerLink
from calm_edge.frontend.association import is_thin
from calm_edge.pose_output.publisher import PosePublisher
from calm_edge.recording.window_record import of_window
from calm_edge.recording.writer import RecordingWriter
from calm_edge.types import CalmEdgeError, KitBelief, PoseSample, PoseStatus, SubmapWindow
from device.frame import Frame

# a cold start from a slow card takes its time; the unit waits for 120 s in all
START_LIMIT_S = 100.0


class DaemonError(CalmEdgeError):
    """The daemon cannot start, or a replay cannot go on."""


class Switchboard:
    """Owner of the links to both children, and of the recording.

    open_writer is called once both children are ready and the cameras are open, so that neither a
    refused configuration nor an absent camera leaves an empty recording behind. Nothing here
    waits, but for `until`.
    """

    def __init__(
        self,
        config: Config,
        source: Source,
        open_writer: Callable[[], RecordingWriter],
        publisher: PosePublisher | None,
        *,
        lockstep: bool,
        say: Callable[[str], None],
    ) -> None:
        self.config, self.source, self.lockstep = config, source, lockstep
        self.result = RecordResult()
        self.writer: RecordingWriter | None = None
        self.kit: KitBelief | None = None
        self.impatient = False
        self.capturing = True
        self.lagging = False
        self.shed = Shed.NOTHING
        self.stage_ms: dict[str, float] = {}
        now_ns = source.clock.now_ns()
        # when each eye last gave a frame, and the tracker a live pose
        self.frame_ns, self.live_ns = [now_ns, now_ns], now_ns
        self.say_to_user = say
        self._open_writer, self.publisher = open_writer, publisher
        self._events: queue.Queue[tuple[Child, Any]] = queue.Queue()
        self.tracker = TrackerLink(config.frontend, self._events, self.say)
        self.estimator = EstimatorLink(
            config, self._events, self.say, lockstep=lockstep, now_ns=source.clock.now_ns
        )

    def start(self) -> None:
        """Waits for both children; raises CalmEdgeError."""
        self.until(
            lambda: (
                (self.tracker.ready and self.estimator.ready)
                or self.estimator.given_up
                or self.tracker.given_up
            ),
            time.monotonic() + START_LIMIT_S,
        )
        if not (self.tracker.ready and self.estimator.ready):
            raise DaemonError("the tracker or the estimator did not start; see the lines above")

    def open_recording(self) -> None:
        """From now on what is handed over is recorded; raises CalmEdgeError."""
        self.writer = self._open_writer()

    def stop(self) -> None:
        """Ends both children."""
        self.estimator.stop()
        self.tracker.stop()

    @property
    def recording(self) -> RecordingWriter:
        """The open recording."""
        assert self.writer is not None
        return self.writer

    def frame(self, frame: Frame) -> None:
        """One frame to the recording and to the tracker, as the same bytes."""
        frame = frame.encoded(self.config.recording.jpeg_quality)
        self.recording.write_frame(frame)
        self.result.frames[frame.eye] += 1
        self.frame_ns[frame.eye] = self.source.clock.now_ns()
        if not self.tracker.offer(frame):
            self.result.untracked += 1

    def leave_out(self, shed: Shed) -> None:
        """From now on works no more than this step allows; frames are always recorded."""
        self.shed = shed
        self.estimator.make_depth(shed < Shed.DEPTH)
        self.tracker.thin_out(shed >= Shed.HALF_THE_WINDOWS)

    def pump(self, wait_s: float = 0.0) -> int:
        """Handles what the children said; how many poses came."""
        poses = 0
        while True:
            try:
                child, message = self._events.get(timeout=wait_s) if wait_s else self._next()
            except queue.Empty:
                break
            wait_s = 0.0
            if child is self.estimator.child:
                self._from_estimator(message)
            elif child is self.tracker.child:
                poses += self._from_tracker(message)
        silent_ms = (self.source.clock.now_ns() - self.live_ns) / 1e6
        self.estimator.capturing = self.capturing
        self.estimator.pose_lost = silent_ms > self.config.frontend.lost_after_ms
        # after what they said was heard, or a capture that slept would take them for hung
        self.estimator.pump()
        self.tracker.pump()
        if self.estimator.lagging != self.lagging:
            self.lagging = self.estimator.lagging
            self.tracker.lag(self.lagging and not self.lockstep)
        if not poses and self.publisher is not None:
            self.publisher.publish(None, self.source.clock.now_ns())
        return poses

    def _next(self) -> tuple[Child, Any]:
        return self._events.get_nowait()

    def _from_tracker(self, message: Any) -> int:
        windows = self.tracker.accept(message)
        if self.tracker.refusal:
            raise DaemonError(self.tracker.refusal)
        for window in windows:
            self._window(window)
        if isinstance(message, Attached):
            self.recording.write_status(
                {
                    "submap_id": message.submap_id,
                    "tracked": message.taken,
                    "T_map_odom": np.asarray(message.T_map_odom).ravel().tolist(),
                }
            )
        if isinstance(message, Tracked):
            self.result.late_poses += message.late
            if message.keyframe is not None and self.shed < Shed.ALL_WINDOWS:
                self.estimator.expect(message.keyframe)
            if message.problem:
                self._unreadable(message.problem)
        if not isinstance(message, Posed):
            return 0
        self._pose(message.sample)
        return 1

    def _pose(self, sample: PoseSample) -> None:
        self.recording.write_pose(sample)
        now_ns = self.source.clock.now_ns()
        if self.publisher is not None:
            self.publisher.publish(sample, now_ns)
        age_ms = None if self.lockstep else (now_ns - sample.t_ns) / 1e6
        self.result.note_pose(sample.status is PoseStatus.LOST, age_ms)
        if sample.status is not PoseStatus.LOST:
            self.live_ns = now_ns

    def _from_estimator(self, message: Any) -> None:
        self.estimator.accept(message)
        if self.estimator.refusal:
            raise DaemonError(self.estimator.refusal)
        problem = getattr(message, "problem", "")
        if problem:
            self.say(f"window {message.submap_id}: {problem}")
        update = getattr(message, "update", None)
        if update is not None:
            self.kit, self.stage_ms = update.kit, update.stage_ms
            for notice in update.notices:
                self.say(notice)
            if message.window is not None:
                self.recording.write_window(message.window)
            self.recording.write_update(update)
            self.result.submaps += 1
            self.tracker.attach(update)

    def _window(self, window: SubmapWindow) -> None:
        self.result.windows += 1
        self.result.keyframes += len(window.primary) - window.n_overlap
        self.recording.write_window(of_window(window))
        if is_thin(window):
            self.say(f"window {window.submap_id}: only {len(window.assistant)} assistant frames")
        if self.shed >= Shed.ALL_WINDOWS:
            self.estimator.leave(window)
        elif not self.estimator.offer(window):
            self.say(f"window {window.submap_id}: estimator too far behind; left to map")

    def _unreadable(self, problem: str) -> None:
        if self.source.is_replay:
            raise DaemonError(f"{self.source.description}: {problem}; replace or remove it")
        self.result.unreadable += 1
        self.say(problem)

    def quiet(self) -> bool:
        """Nothing is under way anywhere."""
        return not (self.tracker.in_flight or self.tracker.attaching or self.estimator.waiting)

    def until(self, done: Callable[[], bool], end_s: float, progress: str = "") -> bool:
        """Handles messages until done; False when end_s (of time.monotonic), or an impatient user,
        ended it.
        """
        said = time.monotonic()
        while not done():
            self.pump(0.05)
            now = time.monotonic()
            if now > end_s or self.impatient:
                return False
            if progress and now - said > 5.0:
                said = now
                self.say_to_user(f"{progress}: {self.estimator.waiting} windows to go")
        return True

    def say(self, text: str) -> None:
        """To the user and into the recording."""
        self.say_to_user(text)
        if self.writer is not None:
            self.writer.write_log(logging.WARNING, text, "daemon")
