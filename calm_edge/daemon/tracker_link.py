"""Interface of the capture process to the tracker process: sends frames, gets windows and poses."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from calm_edge.config import FrontendConfig
from calm_edge.daemon.child import Child
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
from calm_edge.daemon.ring import FrameRing
from calm_edge.recording.window_record import FrameKey, WindowRecord, frame_key, rebuild
from calm_edge.types import LocalizerUpdate, SubmapWindow
from device.frame import Frame

# frames of two cameras at 30 Hz in 0.8 s, during which the tracker may be busy attaching a sub-map
RING_SLOTS = 48
SLOT_BYTES = 4 << 20
MAX_DEATHS_IN_A_ROW = 3
# The process is killed after this time without an answer; a frame takes tens of milliseconds.
HUNG_S = 20.0


def run_tracker(
    connection: Connection, ring_name: str, slot_bytes: int, config: FrontendConfig, start: Counters
) -> None:
    """Main function of the process; imports here, so that capture does not load the tracker."""
    from calm_edge.daemon import tracker_process

    tracker_process.run(connection, ring_name, slot_bytes, config, start)


class TrackerLink:
    """Handle of the tracker process: restarts it after a death, sends it frames, counts losses.

    The tracker returns only the keys of the frames of a window. Their bytes are kept here until the
    tracker releases them or dies: at most RING_SLOTS frames and those of the current window.

    A restarted process continues the ids. Its first window shares no keyframe with the previous
    window, and its poses start a new epoch.
    """

    def __init__(
        self, config: FrontendConfig, events: queue.Queue[Any], say: Callable[[str], None]
    ) -> None:
        self._config, self._events, self._say = config, events, say
        self._counters = Counters()
        self._deaths_in_a_row = 0
        self._flushing = self._lagging = self._sparse = False
        self._answered_s = time.monotonic()
        # frames in the ring, by slot, and frames that were handled but are not yet released
        self._in_ring: dict[int, Frame] = {}
        self._held: dict[FrameKey, Frame] = {}
        self.ready = self.flushed = False
        self.refusal = ""
        self.restarts = 0
        self.frames_lost = 0
        self.attaching = 0
        self._ring, self.child = self._spawn()

    @property
    def given_up(self) -> bool:
        """Whether the process has ended and will not be restarted."""
        return bool(self.refusal) or self._deaths_in_a_row >= MAX_DEATHS_IN_A_ROW

    @property
    def in_flight(self) -> int:
        """Number of frames sent and not yet handled."""
        return len(self._in_ring)

    @property
    def frames_held(self) -> int:
        """Number of frames kept for later windows, those in the ring included."""
        return len(self._in_ring) + len(self._held)

    def offer(self, frame: Frame) -> bool:
        """Send a frame (JPEG); False if the ring has no room for it."""
        assert isinstance(frame.image, bytes)
        slot = self._ring.put(frame.image) if self.child.alive else None
        if slot is None:
            return False
        if not self._in_ring:
            self._answered_s = time.monotonic()
        self._in_ring[slot] = frame
        size = len(frame.image)
        self.child.send(FrameIn(frame.eye, frame.sequence, frame.t_ns, slot, size, frame.own_stamp))
        return True

    def frame_in(self, slot: int) -> Frame:
        """Return the frame in a slot of the ring."""
        return self._in_ring[slot]

    def attach(self, update: LocalizerUpdate) -> None:
        """Send a sub-map to localise against."""
        if not self.given_up:
            self.attaching += 1
            self.child.send(Attach(update))

    def set_lagging(self, lagging: bool) -> None:
        """Send whether the estimator is behind."""
        self._lagging = lagging
        self.child.send(Lagging(lagging))

    def set_sparse(self, sparse: bool) -> None:
        """Select half as many keyframes from now on (True), or the normal number (False)."""
        if sparse != self._sparse:
            self._sparse = sparse
            self.child.send(Sparse(sparse))

    def flush(self) -> None:
        """Request the last windows, after the last frame; `flushed` is set once they arrive."""
        self._flushing = True
        self.child.send(Flush())
        self.flushed |= self.given_up

    def pump(self) -> None:
        """Restart the process if it died, kill it if it hangs."""
        if self._in_ring and time.monotonic() - self._answered_s > HUNG_S:
            self._say(f"tracker has not answered for {HUNG_S:.0f} s; killed")
            self._answered_s = time.monotonic()
            self.child.kill()
        if not self.given_up and not self.child.alive:
            self._replace()

    def accept(self, message: Any) -> tuple[tuple[SubmapWindow, ...], Frame | None]:
        """Handle a message from the current process; return its windows and its keyframe."""
        self._answered_s = time.monotonic()
        match message:
            case Ready():
                self.ready = True
            case Refused():
                self.refusal = message.reason
            case Attached():
                self.attaching -= 1
            case Posed():
                self._counters = self._counters.after_epoch(message.sample.epoch)
            case Tracked():
                frame = self._in_ring.pop(message.slot)
                self._held[frame_key(frame)] = frame
                self._ring.release(message.slot)
                windows = self._windows(message.windows)
                for key in message.released:
                    del self._held[key]
                return windows, frame if message.is_keyframe else None
            case Flushed():
                self.flushed = True
                return self._windows(message.windows), None
        return (), None

    def stop(self) -> None:
        """End the process."""
        self.child.stop(Stop(), 2.0)
        self._ring.close()

    def _windows(self, records: tuple[WindowRecord, ...]) -> tuple[SubmapWindow, ...]:
        for record in records:
            self._counters = self._counters.after_window(record)
            self._deaths_in_a_row = 0
        return tuple(rebuild(record, lambda *key: self._held[key]) for record in records)

    def _spawn(self) -> tuple[FrameRing, Child]:
        ring = FrameRing(RING_SLOTS, SLOT_BYTES)
        arguments = (ring.name, SLOT_BYTES, self._config, self._counters)
        return ring, Child("tracker", run_tracker, arguments, self._events)

    def _replace(self) -> None:
        """Count what was lost with a dead process; restart it unless it died too often in a row."""
        self._deaths_in_a_row += 1
        self.frames_lost += len(self._in_ring)
        self._in_ring.clear()
        self._held.clear()
        self.attaching = 0
        # do not wait for the last windows: they are lost with the dead process
        self.flushed |= self._flushing
        what = f"tracker died (exit {self.child.exit_code})"
        if self.given_up:
            self.flushed = True
            self._say(f"{what}; not restarted: recording continues without poses and windows")
            return
        self._say(f"{what}; restarted, recording continues")
        self.restarts += 1
        self._ring.close()
        self._counters = self._counters.after_death()
        self._ring, self.child = self._spawn()
        self.set_lagging(self._lagging)
        if self._sparse:
            self.child.send(Sparse(True))
