"""The tracker as capture sees it: frames through shared memory to a process that may die."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
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
from calm_edge.daemon.tracker_process_entry import run_tracker
from calm_edge.types import LocalizerUpdate, SubmapWindow
from device.frame import Frame

# most of a second of two cameras at 30 Hz: as long as a new sub-map may hold the tracker up
RING_SLOTS = 48
SLOT_BYTES = 4 << 20
MAX_DEATHS_IN_A_ROW = 3
# a frame takes tens of milliseconds; one that takes this long will never end
HUNG_S = 20.0


class TrackerLink:
    """Owner of the tracker's process, of the ring in front of it and of what is under way in it.

    A new process goes on counting where the dead one's windows ended, so that no id comes twice;
    its first window shares no keyframe with the last one, and its poses begin a new epoch.
    """

    def __init__(
        self, config: FrontendConfig, events: queue.Queue[Any], say: Callable[[str], None]
    ) -> None:
        self._config, self._events, self._say = config, events, say
        self._counters = Counters()
        self._deaths_in_a_row = 0
        self._flushing = self._lagging = self._sparse = False
        self._heard_s = time.monotonic()
        self.ready = self.flushed = False
        self.refusal = ""
        self.restarts = 0
        self.frames_lost = 0
        self.in_flight = self.attaching = 0
        self._ring, self.child = self._spawn()

    @property
    def given_up(self) -> bool:
        """It will not be started again."""
        return bool(self.refusal) or self._deaths_in_a_row >= MAX_DEATHS_IN_A_ROW

    def offer(self, frame: Frame) -> bool:
        """Hands over a frame of JPEG bytes; False when it is too large or the tracker is behind."""
        assert isinstance(frame.image, bytes)
        slot = self._ring.put(frame.image) if self.child.alive else None
        if slot is None:
            return False
        if not self.in_flight:
            self._heard_s = time.monotonic()
        self.in_flight += 1
        size = len(frame.image)
        self.child.send(FrameIn(frame.eye, frame.sequence, frame.t_ns, slot, size))
        return True

    def attach(self, update: LocalizerUpdate) -> None:
        """Hands over a sub-map."""
        if not self.given_up:
            self.attaching += 1
            self.child.send(Attach(update))

    def lag(self, lagging: bool) -> None:
        """Says whether the estimator is behind."""
        self._lagging = lagging
        self.child.send(Lagging(lagging))

    def thin_out(self, sparse: bool) -> None:
        """Half as many keyframes from now on, or all again."""
        if sparse != self._sparse:
            self._sparse = sparse
            self.child.send(Sparse(sparse))

    def flush(self) -> None:
        """No more frames; `flushed` once the last windows are here."""
        self._flushing = True
        self.child.send(Flush())
        self.flushed |= self.given_up

    def pump(self) -> None:
        """Restarts a dead process, ends a hung one."""
        if self.in_flight and time.monotonic() - self._heard_s > HUNG_S:
            self._say(f"tracker has said nothing for {HUNG_S:.0f} s; ended")
            self._heard_s = time.monotonic()
            self.child.kill()
        if not self.given_up and not self.child.alive:
            self._bury()

    def accept(self, message: Any) -> tuple[SubmapWindow, ...]:
        """A message of the present process; the windows in it."""
        self._heard_s = time.monotonic()
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
                self._ring.release(message.slot)
                self.in_flight -= 1
                return self._counted(message.windows)
            case Flushed():
                self.flushed = True
                return self._counted(message.windows)
        return ()

    def stop(self) -> None:
        """Ends the process."""
        self.child.stop(Stop(), 2.0)
        self._ring.close()

    def _counted(self, windows: tuple[SubmapWindow, ...]) -> tuple[SubmapWindow, ...]:
        for window in windows:
            self._counters = self._counters.after_window(window)
            self._deaths_in_a_row = 0
        return windows

    def _spawn(self) -> tuple[FrameRing, Child]:
        ring = FrameRing(RING_SLOTS, SLOT_BYTES)
        arguments = (ring.name, SLOT_BYTES, self._config, self._counters)
        return ring, Child("tracker", run_tracker, arguments, self._events)

    def _bury(self) -> None:
        self._deaths_in_a_row += 1
        self.frames_lost += self.in_flight
        self.in_flight = self.attaching = 0
        # what it had not yet given out is gone with it
        self.flushed |= self._flushing
        what = f"tracker died (exit {self.child.exit_code})"
        if self.given_up:
            self.flushed = True
            self._say(f"{what}; it is not started again: no more poses or windows, but recording")
            return
        self._say(f"{what}; restarted, recording goes on")
        self.restarts += 1
        self._ring.close()
        self._counters = self._counters.after_death()
        self._ring, self.child = self._spawn()
        self.lag(self._lagging)
        if self._sparse:
            self.child.send(Sparse(True))
