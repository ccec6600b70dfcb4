"""Program of the tracker process: keyframes, windows and live poses (paper IV-A)."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

import cv2

from calm_edge.config import FrontendConfig
from calm_edge.daemon.child import serve
from calm_edge.daemon.messages import (
    Attach,
    Attached,
    Counters,
    Flush,
    Flushed,
    FrameIn,
    Lagging,
    Posed,
    Ready,
    Refused,
    Sparse,
    Stop,
    Tracked,
)
from calm_edge.daemon.ring import RingReader
from calm_edge.frontend.association import WindowBuilder, WindowError
from calm_edge.frontend.half_size import MAX_PIXELS, halved
from calm_edge.frontend.keyframes import KeyframeSelector
from calm_edge.frontend.picture_sizes import PictureSizes
from calm_edge.frontend.repeats import RepeatCheck, eighth
from calm_edge.frontend.tracker import CATCH_UP_NS, Tracker
from calm_edge.processes import follow_parent
from calm_edge.recording.window_record import FrameKey, frame_key, of_window
from calm_edge.types import Bytes, Float32, SubmapWindow
from device.frame import Eye, Frame, UnreadableImage

# A primary frame that is older than the newest one received by more than this gets no pose. It is
# less than the time between frames at 10 Hz: there, a frame is skipped once the next has arrived.
LATE_NS = 80_000_000
# Smaller time offsets of the assistant do not change which of its frames are chosen.
LATE_STAMPS_NS = 20_000_000
# How often the points of a pose are sent with it, for people to look at.
MOVES_EVERY_NS = 450_000_000


class TrackerWork:
    """Keyframe selector, window builder and tracker; handles messages of capture in order.

    Frames in keyframes and windows have no image data, which the capture process keeps.
    """

    def __init__(
        self,
        config: FrontendConfig,
        ring: RingReader,
        start: Counters,
        send: Callable[[Posed], None],
    ) -> None:
        self._ring = ring
        self._send = send
        self._selector = KeyframeSelector(config, start.keyframe_id)
        self._builder = WindowBuilder(config, start.submap_id, start.assistant_id)
        self._tracker = Tracker(config, start.epoch)
        self._reduction = 1
        self._lost_after_ns = round(1e6 * config.lost_after_ms)
        self._newest_ns = self._tracked_ns = self._moves_ns = 0
        self._held: set[FrameKey] = set()
        self._repeats = {eye: RepeatCheck() for eye in Eye}
        self._sizes = PictureSizes()

    def on_arrival(self, message: Any) -> None:
        """Note the stamp of the newest primary frame received, possibly not yet processed."""
        if isinstance(message, FrameIn) and message.eye is Eye.PRIMARY:
            self._newest_ns = message.t_ns

    def handle(self, message: Any) -> Any:
        """Handle one message; return the answer, or None if it needs none."""
        match message:
            case FrameIn():
                return self._handle_frame(message)
            case Attach():
                update = halved(message.update) if self._reduction == 2 else message.update
                taken = self._tracker.attach(update)
                late_ns = update.submap.late_ns
                self._builder.late_ns = late_ns if abs(late_ns) > LATE_STAMPS_NS else 0
                return Attached(message.update.submap.id, taken, self._tracker.T_map_odom)
            case Lagging():
                self._tracker.lagging = message.lagging
            case Sparse():
                self._selector.sparse = message.sparse
            case Flush():
                return Flushed(tuple(map(of_window, self._builder.flush())))
        return None

    def _handle_frame(self, message: FrameIn) -> Tracked:
        late, is_keyframe, problem, repeat = self._is_late(message), False, "", False
        frame = Frame(message.eye, message.sequence, message.t_ns, b"", message.own_stamp)
        windows: tuple[SubmapWindow, ...] = ()
        resized = ""
        if late and self._can_wait(message.t_ns):
            windows = self._builder.advance(message.t_ns)
        else:
            image = self._ring.read(message.slot, message.size)
            try:
                picture = dataclasses.replace(frame, image=image)
                resized = self._sizes.change(picture)
                before = self._cut() if resized else ()
                windows, is_keyframe, repeat = self._track(picture, frame, late)
                windows = before + windows
            except UnreadableImage as error:
                problem, late = str(error), False
        return Tracked(
            message.slot,
            tuple(map(of_window, windows)),
            self._released(frame),
            is_keyframe,
            problem,
            late and not repeat,
            repeat=frame.eye if repeat else None,
            resized=resized,
        )

    def _cut(self) -> tuple[SubmapWindow, ...]:
        """Begin anew, with pictures of another size; return the windows of the former one."""
        self._tracker.restart()
        self._repeats = {eye: RepeatCheck() for eye in Eye}
        return self._builder.cut()

    def _released(self, frame: Frame) -> tuple[FrameKey, ...]:
        """Add the newest frame; return the held frames that no later window can contain."""
        self._held.add(frame_key(frame))
        still = {frame_key(f) for f in self._builder.held()}
        released = self._held - still
        self._held &= still
        return tuple(sorted(released))

    def _is_late(self, message: FrameIn) -> bool:
        return message.eye is Eye.PRIMARY and self._newest_ns - message.t_ns > LATE_NS

    def _can_wait(self, t_ns: int) -> bool:
        """Whether tracking still succeeds if the frame at t_ns is skipped for a newer one."""
        near = self._newest_ns - self._tracked_ns <= self._lost_after_ns
        return near or t_ns - self._tracked_ns < CATCH_UP_NS

    def _gray(self, frame: Frame) -> Bytes:
        """Decode the image to grey, at half size if it is large."""
        gray = frame.gray(self._reduction)
        reduction = 2 if gray.size * self._reduction**2 > MAX_PIXELS else 1
        if reduction != self._reduction:
            self._reduction = reduction
            gray = frame.gray(reduction)
        return gray

    def _track(
        self, picture: Frame, frame: Frame, late: bool
    ) -> tuple[tuple[SubmapWindow, ...], bool, bool]:
        """Process a frame; return the windows it completes, and whether it is a primary keyframe.

        picture: the frame with its image. Also whether it only repeats the picture before. Raises
        UnreadableImage.
        """
        image = picture.image
        assert isinstance(image, bytes)
        repeats = self._repeats[frame.eye]
        if frame.eye is Eye.ASSISTANT:
            # not used for tracking: 1/8 of its size shows whether it is readable and a repeat
            if repeats.is_repeat(frame.t_ns, image, picture.gray(8)):
                return (), False, True
            return self._builder.add_assistant(frame), False, False
        gray = self._gray(picture)
        if repeats.is_repeat(frame.t_ns, image, eighth(gray, self._reduction)):
            return self._builder.advance(frame.t_ns), False, True
        self._tracked_ns = frame.t_ns
        sample = self._tracker.track(frame.t_ns, gray, own_stamp=frame.own_stamp)
        if not late:
            # before keyframe selection, which takes time: latency of the pose matters
            self._send(Posed(sample, self._moves(frame.t_ns)))
        keyframe = self._selector.consider(frame, gray)
        self._tracker.prepare(keyframe.id if keyframe else None, behind=late)
        windows = self._builder.advance(frame.t_ns)
        if keyframe is not None:
            windows += self._builder.add_keyframe(keyframe)
        return windows, keyframe is not None, False

    def _moves(self, t_ns: int) -> Float32 | None:
        """Points of the pose just computed, in pixels of the full picture; None if not yet due."""
        if t_ns - self._moves_ns < MOVES_EVERY_NS:
            return None
        self._moves_ns = t_ns
        # centres of pixels are whole numbers, also of the halved picture
        return (self._tracker.moves + 0.5) * self._reduction - 0.5


def run(
    connection: Connection, ring_name: str, slot_bytes: int, config: FrontendConfig, start: Counters
) -> None:
    """Main function of the process; serves messages until Stop."""
    follow_parent()
    # lower priority than capture: recording of frames is more important than poses
    os.nice(2)
    cv2.setNumThreads(1)
    ring = RingReader(ring_name, slot_bytes)
    try:
        work = TrackerWork(config, ring, start, connection.send)
    except WindowError as error:
        connection.send(Refused(str(error)))
        return
    connection.send(Ready())
    serve(connection, Stop, work.handle, work.on_arrival)
    ring.close()
