"""The tracker process: keyframes, windows, and a pose for every primary frame (paper IV-A)."""

from __future__ import annotations

import os
import signal
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
from calm_edge.frontend.half_size import MOST_PIXELS, halved
from calm_edge.frontend.keyframes import KeyframeSelector
from calm_edge.frontend.tracker import CATCH_UP_NS, Tracker
from calm_edge.types import Bytes, SubmapWindow
from device.frame import Eye, Frame, UnreadableImage

# A frame that newer ones have outrun by this much has no pose to give any more: at ten frames a
# second one newer frame is enough.
LATE_NS = 80_000_000


class TrackerWork:
    """Selector, window builder and tracker, fed by messages in order; `overhear` comes first."""

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
        self._newest_ns = self._tracked_ns = 0

    def overhear(self, message: Any) -> None:
        """A message has come, and others may be handled before it."""
        if isinstance(message, FrameIn) and message.eye is Eye.PRIMARY:
            self._newest_ns = message.t_ns

    def handle(self, message: Any) -> Any:
        """The answer to one message, None where there is none."""
        match message:
            case FrameIn():
                late = self._is_late(message)
                if late and self._can_wait(message.t_ns):
                    return Tracked(message.slot, self._builder.advance(message.t_ns), late=True)
                data = self._ring.read(message.slot, message.size)
                frame = Frame(message.eye, message.sequence, message.t_ns, data)
                try:
                    windows, is_keyframe = self._frame(frame, late)
                except UnreadableImage as error:
                    return Tracked(message.slot, (), problem=str(error))
                keyframe = frame if is_keyframe else None
                return Tracked(message.slot, windows, keyframe, late=late)
            case Attach():
                update = halved(message.update) if self._reduction == 2 else message.update
                taken = self._tracker.attach(update)
                return Attached(message.update.submap.id, taken, self._tracker.T_map_odom)
            case Lagging():
                self._tracker.lagging = message.lagging
            case Sparse():
                self._selector.sparse = message.sparse
            case Flush():
                return Flushed(self._builder.flush())
        return None

    def _is_late(self, message: FrameIn) -> bool:
        return message.eye is Eye.PRIMARY and self._newest_ns - message.t_ns > LATE_NS

    def _can_wait(self, t_ns: int) -> bool:
        """Whether a newer frame than the one of t_ns can be tracked from the last one that was."""
        near = self._newest_ns - self._tracked_ns <= self._lost_after_ns
        return near or t_ns - self._tracked_ns < CATCH_UP_NS

    def _gray(self, frame: Frame) -> Bytes:
        """The picture at the size it is tracked at; a camera that changes its size begins anew."""
        gray = frame.gray(self._reduction)
        reduction = 2 if gray.size * self._reduction**2 > MOST_PIXELS else 1
        if reduction != self._reduction:
            self._reduction = reduction
            gray = frame.gray(reduction)
        return gray

    def _frame(self, frame: Frame, late: bool) -> tuple[tuple[SubmapWindow, ...], bool]:
        """The windows it completes, and whether it became a primary keyframe."""
        if frame.eye is Eye.ASSISTANT:
            # nothing is done with its pixels here but to see that there are any
            frame.gray(8)
            return self._builder.add_assistant(frame), False
        gray = self._gray(frame)
        self._tracked_ns = frame.t_ns
        sample = self._tracker.track(frame.t_ns, gray)
        if not late:
            # the pose leaves first: whoever steers by it waits for nothing else
            self._send(Posed(sample))
        keyframe = self._selector.consider(frame, gray)
        self._tracker.prepare(keyframe.id if keyframe else None, in_haste=late)
        windows = self._builder.advance(frame.t_ns)
        if keyframe is not None:
            windows += self._builder.add_keyframe(keyframe)
        return windows, keyframe is not None


def run_tracker(
    connection: Connection, ring_name: str, slot_bytes: int, config: FrontendConfig, start: Counters
) -> None:
    """The process's main function."""
    # the terminal's Ctrl-C goes to every process; only capture acts on it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # a late pose is better than a late frame
    os.nice(2)
    cv2.setNumThreads(1)
    ring = RingReader(ring_name, slot_bytes)
    try:
        work = TrackerWork(config, ring, start, connection.send)
    except WindowError as error:
        connection.send(Refused(str(error)))
        return
    connection.send(Ready())
    serve(connection, Stop, work.handle, work.overhear)
    ring.close()
