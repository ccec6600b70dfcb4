"""Pass frames to the tracker, windows to the estimator, and the results of both to the outputs."""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from calm_edge.config import Config
from calm_edge.daemon.child import Child
from calm_edge.daemon.estimator_link import EstimatorLink
from calm_edge.daemon.fan_out import FanOut, Output
from calm_edge.daemon.hub_status import HubStatus, take_status
from calm_edge.daemon.ladder import Shed
from calm_edge.daemon.messages import Attached, Event, Keep, Posed, Processed, Tracked
from calm_edge.daemon.outputs import RecordingOutput
from calm_edge.daemon.picture_samples import PictureSamples
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.source import Source
from calm_edge.daemon.tracker_link import TrackerLink
from calm_edge.frontend.association import is_thin
from calm_edge.recording.record import array_bytes
from calm_edge.recording.sensors import Sample
from calm_edge.recording.window_record import of_window
from calm_edge.types import (
    CalmEdgeError,
    LocalizerUpdate,
    Metre,
    PoseSample,
    PoseStatus,
    SubmapWindow,
)
from device.frame import Eye, Frame
from device.gps.fix import Fix
from device.seldom import Seldom

# Loading all modules from a slow SD card takes long; systemd allows 120 s (TimeoutStartSec).
START_LIMIT_S = 100.0
# A replay misses nothing while it waits for a busy computer.
REPLAY_START_LIMIT_S = 600.0
# repeated pictures of a camera after which the user is warned
REPEATS_SAID = 3


class DaemonError(CalmEdgeError):
    """The daemon cannot start, or a replay cannot go on."""


class Hub:
    """Starts tracker, estimator and outputs (the recording first), and passes data between them.

    `Capture` opens the recording once both processes are ready and the cameras are open, so that an
    invalid configuration or a missing camera leaves no empty recording. Only `start` and `until`
    wait for anything. say: prints a line for the user.
    """

    def __init__(
        self,
        config: Config,
        source: Source,
        recording: RecordingOutput,
        outputs: Sequence[Output] = (),
        *,
        lockstep: bool,
        say: Callable[[str], None],
    ) -> None:
        self.config, self.source, self.lockstep = config, source, lockstep
        self.result = RecordResult(spacing_m=config.scale.spacing_m)
        self.recording, self.outputs = recording, FanOut([recording, *outputs])
        self.impatient = False
        self.capturing = True
        self._lagging = False
        self._shed = Shed.NOTHING
        self._stage_ms: dict[str, float] = {}
        now_ns = source.clock.now_ns()
        # time of the last frame of each camera, and of the last live pose
        self._frame_ns, self._pose_ns = [now_ns, now_ns], now_ns
        self.say_to_user = say
        self._say_unreadable = Seldom(self.say)
        self._samples = PictureSamples()
        self._events: queue.Queue[tuple[Child, Any]] = queue.Queue()
        self.tracker = TrackerLink(config.frontend, self._events, self.say)
        self.estimator = EstimatorLink(
            config, self._events, self.say, lockstep=lockstep, now_ns=source.clock.now_ns
        )

    def start(self) -> None:
        """Wait until tracker and estimator are ready; raises CalmEdgeError after a time limit."""
        limit_s = REPLAY_START_LIMIT_S if self.source.is_replay else START_LIMIT_S
        self.until(
            lambda: (
                (self.tracker.ready and self.estimator.ready)
                or self.estimator.given_up
                or self.tracker.given_up
            ),
            time.monotonic() + limit_s,
        )
        if not (self.tracker.ready and self.estimator.ready):
            if not (self.tracker.given_up or self.estimator.given_up or self.impatient):
                raise DaemonError(
                    f"the tracker or the estimator was not ready within {limit_s:.0f} s: the "
                    "computer is busy or its disk slow; end other programs and start again"
                )
            raise DaemonError("the tracker or the estimator did not start; see the lines above")

    def stop(self) -> None:
        """End tracker and estimator, count the losses in `result` and close the outputs."""
        self.estimator.stop()
        self.tracker.stop()
        self.result.end_unfinished()
        if not self.result.windows and any(self.result.frames):
            self.result.no_window = self._samples.causes()
        result, estimator = self.result, self.estimator
        result.lost_windows = sorted(estimator.lost)
        result.windows_left_to_map = sorted(estimator.left_to_map)
        result.unsolved_windows = sorted(estimator.unsolved)
        result.estimator_restarts = estimator.restarts
        result.tracker_restarts = self.tracker.restarts
        result.untracked += self.tracker.frames_lost
        self.outputs.close(result)

    def frame(self, frame: Frame) -> None:
        """Encode one frame as JPEG and pass it to the outputs and to the tracker."""
        frame = frame.encoded(self.config.recording.jpeg_quality)
        self.outputs.frame(frame)
        if not self.result.windows:
            self._samples.add(frame)
        self.result.frames[frame.eye] += 1
        self._frame_ns[frame.eye] = self.source.clock.now_ns()
        if not self.tracker.offer(frame):
            self.result.untracked += 1

    def take_samples(self) -> None:
        """Pass on what the sensors beside the cameras have sent; never waits for them."""
        now_ns = self.source.clock.now_ns()
        for sensor in self.source.sensors:
            for sample in sensor.take(now_ns):
                self.outputs.give(partial(_give_sample, sample))
                self.result.gps_fixes += isinstance(sample, Fix) and sample.has_position

    def leave_out(self, shed: Shed, why: str) -> None:
        """Leave out the work of a load-shedding step. why: the reason, for the user."""
        if shed is self._shed:
            return
        self._shed = shed
        self.estimator.make_depth(shed < Shed.DEPTH)
        self.tracker.set_sparse(shed >= Shed.HALF_THE_WINDOWS)
        self.say(f"{shed.words}: {why}; every frame is recorded")

    def pump(self, wait_s: float = 0.0) -> int:
        """Handle all messages of tracker and estimator; return the number of poses among them.

        wait_s: how long to wait for the first message.
        """
        poses = 0
        while True:
            try:
                child, message = (
                    self._events.get(timeout=wait_s) if wait_s else self._events.get_nowait()
                )
            except queue.Empty:
                break
            wait_s = 0.0
            if child is self.estimator.child:
                self._from_estimator(message)
            elif child is self.tracker.child:
                poses += self._from_tracker(message)
        for request in self.outputs.requests():
            self._answer(request)
        silent_ms = (self.source.clock.now_ns() - self._pose_ns) / 1e6
        self.estimator.capturing = self.capturing
        self.estimator.pose_lost = silent_ms > self.config.frontend.lost_after_ms
        # only after handling the messages of estimator and tracker: if this process was suspended,
        # their answers are waiting, and without these both would be killed as hanging
        self.estimator.pump()
        self.tracker.pump()
        # without a sub-map of the newest window poses continue an older one: they are not LIVE
        late = self.estimator.lagging and not self.lockstep
        if (lagging := late or bool(self.estimator.refused)) != self._lagging:
            self._lagging = lagging
            self.tracker.set_lagging(lagging)
        if not poses:
            self.outputs.tick(self.source.clock.now_ns())
        return poses

    def quiet(self) -> bool:
        """Whether tracker and estimator have no work left."""
        return not (self.tracker.in_flight or self.tracker.attaching or self.estimator.waiting)

    def until(self, done: Callable[[], bool], end_s: float, progress: str = "") -> bool:
        """Handle messages until done() holds; return whether it does.

        False at end_s [s] on time.monotonic, or once `impatient` is set: the user has requested
        the stop twice. progress: text to print every 5 s, with the number of waiting windows.
        """
        reported_s = time.monotonic()
        while not done():
            self.pump(0.05)
            now_s = time.monotonic()
            if now_s > end_s or self.impatient:
                return False
            if progress and now_s - reported_s > 5.0:
                reported_s = now_s
                self.say_to_user(f"{progress}: {self.estimator.waiting} windows left to solve")
        return True

    def say(self, text: str) -> None:
        """Print a warning for the user and pass it to the outputs."""
        self.say_to_user(text)
        self.outputs.give(lambda output: output.say(logging.WARNING, text, "daemon"))

    def give_update(self, update: LocalizerUpdate) -> None:
        """Pass a new or moved sub-map to the outputs."""
        self.outputs.give(lambda output: output.update(update), array_bytes(update))

    def take_status(self) -> HubStatus:
        """Return the counters so far, and the largest pose age since the last call."""
        return take_status(
            self.result,
            self.tracker,
            self.estimator,
            self.outputs,
            self.recording.health,
            self.source.sensors,
            now_ns=self.source.clock.now_ns(),
            frame_ns=(self._frame_ns[0], self._frame_ns[1]),
            pose_ns=self._pose_ns,
            stage_ms=self._stage_ms,
        )

    def _from_tracker(self, message: Any) -> int:
        unreadable = None
        if isinstance(message, Tracked) and message.problem:
            unreadable = self.tracker.frame_in(message.slot)
        windows, keyframe = self.tracker.accept(message)
        if self.tracker.refusal:
            raise DaemonError(self.tracker.refusal)
        for window in windows:
            self._window(window)
        if keyframe is not None and self._shed < Shed.ALL_WINDOWS:
            self.estimator.expect(keyframe)
        match message:
            case Attached():
                self.outputs.give(lambda output: output.attached(message))
            case Tracked():
                self.result.late_poses += message.late
                if message.resized:
                    self.say(message.resized)
                if message.repeat is not None:
                    self._repeated(message.repeat)
                if unreadable is not None:
                    name = self.source.name_of(unreadable)
                    self._unreadable(f"{name}: {message.problem}" if name else message.problem)
            case Posed():
                self._pose(message.sample)
                if (moves := message.moves) is not None:
                    t_ns = message.sample.t_ns
                    self.outputs.give(lambda output: output.moves(t_ns, moves), moves.nbytes)
                return 1
        return 0

    def _answer(self, request: Event | Keep) -> None:
        if isinstance(request, Event):
            self.outputs.give(lambda output: output.event(request))
        else:
            self.outputs.give(lambda output: output.keep(request.kept))

    def _pose(self, sample: PoseSample) -> None:
        sample = unscaled_without(self.result.metre, sample)
        now_ns = self.source.clock.now_ns()
        self.outputs.give(lambda output: output.pose(sample, now_ns))
        age_ms = None if self.lockstep else (now_ns - sample.t_ns) / 1e6
        self.result.note_pose(sample.status, age_ms)
        if sample.status is not PoseStatus.LOST:
            self._pose_ns = now_ns

    def _from_estimator(self, message: Any) -> None:
        self.estimator.accept(message)
        if self.estimator.refusal:
            raise DaemonError(self.estimator.refusal)
        if not isinstance(message, Processed):
            return
        if message.metre is not None:
            self.result.metre = message.metre
        if message.problem:
            self.say(f"window {message.submap_id}: {message.problem}")
        if (update := message.update) is not None:
            self._stage_ms = update.stage_ms
            for notice in update.notices:
                self.say(notice)
            if (record := message.window) is not None:
                self.outputs.give(lambda output: output.window(record))
            self.give_update(update)
            self.result.note_trajectory(update.trajectory, self.estimator.restarts)
            self.result.submaps += 1
            self.tracker.attach(update)

    def _window(self, window: SubmapWindow) -> None:
        self.result.windows += 1
        self._samples.clear()
        self.result.keyframes += len(window.primary) - window.n_overlap
        record = of_window(window)
        self.outputs.give(lambda output: output.window(record))
        if is_thin(window):
            n = len(window.assistant)
            self.say(f"window {window.submap_id}: only {n} assistant frames; scale inaccurate")
        if self._shed >= Shed.ALL_WINDOWS:
            self.estimator.leave_to_map(window)
        elif not self.estimator.offer(window):
            self.say(f"window {window.submap_id}: the queue is full; left for calm-edge map")

    def _repeated(self, eye: Eye) -> None:
        self.result.repeated[eye] += 1
        # a single one is only counted
        if self.result.repeated[eye] == REPEATS_SAID:
            remedy = "" if self.source.is_replay else "; choose a lower capture.rate_hz"
            self.say(
                f"{eye.name.lower()} camera: repeats pictures under new stamps; "
                f"such frames get no pose, and are counted{remedy}"
            )

    def _unreadable(self, problem: str) -> None:
        self.result.unreadable += 1
        self._say_unreadable(f"{problem}; left out")


def _give_sample(sample: Sample, output: Output) -> None:
    output.sample(sample)


def unscaled_without(metre: Metre, sample: PoseSample) -> PoseSample:
    """Return the sample as not metric if the drive has no metre.

    What speaks against the lengths of a drive may be found after the sub-map of the pose was
    solved, or in a window that could not be solved.
    """
    if not sample.status.usable or np.isfinite(metre.log_sigma):
        return sample
    return replace(sample, status=PoseStatus.UNSCALED, scale_log_sigma=np.inf)
