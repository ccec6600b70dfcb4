"""The estimator as capture sees it: a bounded inbox in front of a process that may die."""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from calm_edge.config import Config
from calm_edge.daemon.child import Child
from calm_edge.daemon.estimator_process_entry import run_estimator
from calm_edge.daemon.messages import (
    Expect,
    Finish,
    Finished,
    LeftOut,
    MakeDepth,
    Process,
    Processed,
    Ready,
    Refused,
    Stop,
)
from calm_edge.frontend.remembered import REMEMBERED_NS
from calm_edge.types import SubmapWindow
from device.frame import Frame

# A window holds some 5 MB of JPEG. Beyond this they are left to `map`.
INBOX_WINDOWS = 32
LAGGING_WINDOWS = 2
MAX_DEATHS_IN_A_ROW = 3
# the slowest models take a minute or two; a window that takes this long will never end
HUNG_S = 300.0
# A sub-map as old as what the tracker remembers cannot be followed to now; the last quarter is for
# the way to now itself.
IN_TIME_S = 0.75 * REMEMBERED_NS / 1e9


class EstimatorLink:
    """Owner of the estimator's process, its inbox and what was lost with it.

    now_ns: the clock of the frames' stamps.
    """

    def __init__(
        self,
        config: Config,
        events: queue.Queue[Any],
        say: Callable[[str], None],
        *,
        lockstep: bool = False,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._config = config
        self._now_ns = now_ns
        self._lockstep = lockstep
        self._events = events
        self._say = say
        self._inbox: deque[SubmapWindow] = deque()
        self._in_hand: SubmapWindow | None = None
        self._left_out: list[LeftOut] = []
        self._took_s = 0.0
        self._ready = self._expects_pictures = False
        self._deaths_in_a_row = 0
        self._finishing = False
        self._make_depth = True
        self._handed_s = 0.0
        self._died_finishing = False
        self.refusal = ""
        # while frames come a pose in time counts most; without one, nothing but the next one
        self.capturing, self.pose_lost = True, False
        # windows of those left to map that newer ones went before
        self.overtaken = 0
        self.lost: list[int] = []
        self.left_to_map: list[int] = []
        self.unsolved: list[int] = []
        self.restarts = 0
        self.finished: Finished | None = None
        self.child = self._spawn()

    @property
    def ready(self) -> bool:
        return self._ready

    @property
    def given_up(self) -> bool:
        """It will not be started again."""
        hopeless = self._deaths_in_a_row >= MAX_DEATHS_IN_A_ROW
        return bool(self.refusal) or hopeless or self._died_finishing

    @property
    def waiting(self) -> int:
        """Windows not yet answered."""
        return 0 if self.given_up else len(self._inbox) + (self._in_hand is not None)

    @property
    def lagging(self) -> bool:
        return self.given_up or self.waiting > LAGGING_WINDOWS

    def offer(self, window: SubmapWindow) -> bool:
        """Queues a window; False when there is no room: then only `map` will see it."""
        if self.given_up or len(self._inbox) >= INBOX_WINDOWS:
            self.leave(window)
            return False
        self._inbox.append(window)
        self.pump()
        return True

    def expect(self, keyframe: Frame) -> None:
        """A primary keyframe of a window to come; while windows wait there is no time for it."""
        wanted = self._ready and self._expects_pictures
        if wanted and not self.given_up and not self._inbox:
            self.child.send(Expect(keyframe))

    def leave(self, window: SubmapWindow) -> None:
        """A window that only `map` will see, for the machine has no time for it now."""
        self.left_to_map.append(window.submap_id)
        if not self.given_up:
            stamps = tuple(keyframe.frame.t_ns for keyframe in window.primary)
            self._left_out.append(LeftOut(window.submap_id, stamps))

    def make_depth(self, on: bool) -> None:
        """Depth where the configuration asks for it, or left to `map`."""
        if on != self._make_depth:
            self._make_depth = on
            self.child.send(MakeDepth(on))

    def pump(self) -> None:
        """Restarts a dead process, ends a hung one, hands the next window to an idle one."""
        if self.given_up:
            return
        hung = self._in_hand is not None and time.monotonic() - self._handed_s > HUNG_S
        if hung and not self._lockstep:
            self._say(f"estimator has not answered for {HUNG_S:.0f} s; ended")
            self.child.kill()
        if not self.child.alive:
            self._bury()
        elif self._ready and self._in_hand is None and self._inbox:
            if not self._lockstep:
                self._catch_up()
            self._in_hand, self._handed_s = self._inbox.popleft(), time.monotonic()
            self.child.send(Process(self._in_hand, tuple(self._left_out)))
            self._left_out.clear()

    def accept(self, message: Any) -> None:
        """A message of the present process."""
        match message:
            case Ready():
                self._ready, self._expects_pictures = True, message.expects_pictures
            case Refused():
                self.refusal = message.reason
            case Processed():
                self._took_s = time.monotonic() - self._handed_s
                self._in_hand = None
                self._deaths_in_a_row = 0
                if message.update is None:
                    self.unsolved.append(message.submap_id)
            case Finished():
                self.finished = message
        self.pump()

    def finish(self) -> None:
        """Asks for the joint optimum; then `finished` is set, or it has `given_up`."""
        self._finishing = True
        self.child.send(Finish())

    def stop(self, timeout_s: float = 2.0) -> None:
        """Ends the process; windows not yet answered are lost to the live run."""
        self.lost += [w.submap_id for w in (*self._inbox, *filter(None, [self._in_hand]))]
        self._inbox.clear()
        self._in_hand = None
        self.child.stop(Stop(), timeout_s)

    def _catch_up(self) -> None:
        """All but the newest window are left to `map` where the next would give no pose any more.

        One after the other they would all be too late: each is solved while others come. And where
        the pose is lost it was lost on the way from an earlier window, and would be again.
        """
        if not self.capturing or len(self._inbox) < 2:
            return
        waited_s = (self._now_ns() - self._inbox[0].primary[-1].frame.t_ns) / 1e9
        if not self.pose_lost and waited_s + self._took_s <= IN_TIME_S:
            return
        *late, newest = self._inbox
        if not self.overtaken:
            # once: from here on the status counts them
            self._say("windows come too late to give a pose: newer ones go first, late ones to map")
        self.overtaken += len(late)
        for window in late:
            self.leave(window)
        self._inbox = deque([newest])

    def _spawn(self) -> Child:
        return Child("estimator", run_estimator, (self._config, self._lockstep), self._events)

    def _bury(self) -> None:
        self._deaths_in_a_row += 1
        self._ready = False
        self._died_finishing = self._finishing
        what = f"estimator died (exit {self.child.exit_code})"
        if self._in_hand is not None:
            self.lost.append(self._in_hand.submap_id)
            what += f", window {self._in_hand.submap_id} lost with it"
            self._in_hand = None
        if self.given_up:
            self._say(f"{what}; it is not started again, recording goes on: run map later")
            self.lost += [w.submap_id for w in self._inbox]
            self._inbox.clear()
            return
        self._say(f"{what}; restarted, recording goes on")
        self.restarts += 1
        self.child = self._spawn()
        if not self._make_depth:
            self.child.send(MakeDepth(False))
