"""Interface of the capture process to the estimator process: window queue, restart after death."""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from calm_edge.config import Config
from calm_edge.daemon.child import Child
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
from calm_edge.daemon.received_frames import kept_frames
from calm_edge.frontend.remembered import REMEMBERED_NS
from calm_edge.recording.window_record import FrameKey, frame_key, of_window
from calm_edge.types import SubmapWindow
from device.frame import Frame

# Length of the window queue, about 4 MB of JPEG each. Further windows are left for `calm-edge map`.
INBOX_WINDOWS = 32
LAGGING_WINDOWS = 2
MAX_DEATHS_IN_A_ROW = 3
# The process is killed after this time without an answer; the slowest models take two minutes.
HUNG_S = 300.0
# Oldest age of a sub-map for live poses: the tracker must still hold the sub-map's frames
# (REMEMBERED_NS), and needs a quarter of that time to track from them to the newest frame.
IN_TIME_S = 0.75 * REMEMBERED_NS / 1e9


def run_estimator(connection: Connection, config: Config, lockstep: bool) -> None:
    """Main function of the process; imports here, so that capture does not load the solver."""
    from calm_edge.daemon import estimator_process

    estimator_process.run(connection, config, lockstep)


class EstimatorLink:
    """Handle of the estimator process: restarts it after a death, queues windows, counts losses.

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
        # id of the window that the process is solving; None if it is idle
        self._in_hand: int | None = None
        # frames that have been sent to the current process
        self._sent: set[FrameKey] = set()
        self._left_out: list[LeftOut] = []
        self._took_s = 0.0
        self._ready = self._expects_pictures = False
        self._deaths_in_a_row = 0
        self._finishing = False
        self._make_depth = True
        self._handed_s = 0.0
        self._died_finishing = False
        self.refusal = ""
        # for _catch_up, set by the hub: frames are still captured; the live pose is lost
        self.capturing, self.pose_lost = True, False
        # number of windows skipped in favour of newer ones
        self.overtaken = 0
        self.lost: list[int] = []
        self.left_to_map: list[int] = []
        self.unsolved: list[int] = []
        # why the newest window gave no sub-map; empty if it gave one
        self.refused = ""
        # number of windows that were solved only at a later attempt
        self.solved_late = 0
        self.restarts = 0
        self.finished: Finished | None = None
        self.child = self._spawn()

    @property
    def ready(self) -> bool:
        return self._ready

    @property
    def given_up(self) -> bool:
        """Whether the process has ended and will not be restarted."""
        hopeless = self._deaths_in_a_row >= MAX_DEATHS_IN_A_ROW
        return bool(self.refusal) or hopeless or self._died_finishing

    @property
    def waiting(self) -> int:
        """Number of windows not yet processed."""
        return 0 if self.given_up else len(self._inbox) + (self._in_hand is not None)

    @property
    def lagging(self) -> bool:
        return self.given_up or self.waiting > LAGGING_WINDOWS

    def offer(self, window: SubmapWindow) -> bool:
        """Queue a window; False if the queue is full: it is left for `calm-edge map`."""
        if self.given_up or len(self._inbox) >= INBOX_WINDOWS:
            self.leave_to_map(window)
            return False
        self._inbox.append(window)
        self.pump()
        return True

    def expect(self, keyframe: Frame) -> None:
        """Send a new primary keyframe, for early computation of features, unless windows wait."""
        wanted = self._ready and self._expects_pictures
        if wanted and not self.given_up and not self._inbox:
            self._sent.add(frame_key(keyframe))
            self.child.send(Expect(keyframe))

    def leave_to_map(self, window: SubmapWindow) -> None:
        """Do not process a window: `calm-edge map` will, after the drive."""
        self.left_to_map.append(window.submap_id)
        if not self.given_up:
            stamps = tuple(keyframe.frame.t_ns for keyframe in window.primary)
            self._left_out.append(LeftOut(window.submap_id, stamps))

    def make_depth(self, on: bool) -> None:
        """Turn on or off the computation of dense depth; if off, `calm-edge map` computes it."""
        if on != self._make_depth:
            self._make_depth = on
            self.child.send(MakeDepth(on))

    def pump(self) -> None:
        """Restart the process if it died, kill it if it hangs, send a window if it is idle."""
        if self.given_up:
            return
        hung = self._in_hand is not None and time.monotonic() - self._handed_s > HUNG_S
        if hung and not self._lockstep:
            self._say(f"estimator has not answered for {HUNG_S:.0f} s; killed")
            self.child.kill()
        if not self.child.alive:
            self._replace()
        elif self._ready and self._in_hand is None and self._inbox:
            if not self._lockstep:
                self._catch_up()
            self._hand_over(self._inbox.popleft())

    def accept(self, message: Any) -> None:
        """Handle a message from the current process."""
        match message:
            case Ready():
                self._ready, self._expects_pictures = True, message.expects_pictures
            case Refused():
                self.refusal = message.reason
            case Processed():
                self._took_s = time.monotonic() - self._handed_s
                self._in_hand = None
                self._deaths_in_a_row = 0
                self.refused = ""
                if message.update is None:
                    self.unsolved.append(message.submap_id)
                    self.refused = f"window {message.submap_id} gave no sub-map: {message.problem}"
            case Finished():
                self.finished = message
                late = {submap.id for submap in message.submaps} & {*self.unsolved}
                self.unsolved = [i for i in self.unsolved if i not in late]
                self.solved_late = len(late)
        self.pump()

    def finish(self) -> None:
        """Request the joint optimum; later `finished` holds it, or `given_up` becomes true."""
        self._finishing = True
        self.child.send(Finish())

    def stop(self, timeout_s: float = 2.0) -> None:
        """End the process; windows not yet processed are lost."""
        self.lost += [w.submap_id for w in self._inbox]
        if self._in_hand is not None:
            self.lost.append(self._in_hand)
        self._inbox.clear()
        self._in_hand = None
        self.child.stop(Stop(), timeout_s)

    def _hand_over(self, window: SubmapWindow) -> None:
        record = of_window(window)
        frames = [k.frame for k in window.keyframes() if frame_key(k.frame) not in self._sent]
        self._sent = kept_frames(self._sent.union(record.frame_keys), record)
        self._in_hand, self._handed_s = window.submap_id, time.monotonic()
        self.child.send(Process(record, tuple(frames), tuple(self._left_out)))
        self._left_out.clear()

    def _catch_up(self) -> None:
        """Skip all queued windows but the newest if the oldest is too old to give a live pose.

        Otherwise the queue would never get shorter, and every sub-map would be too old. They are
        also skipped while the live pose is lost: the tracker could not track from an old window to
        the newest frame. `calm-edge map` processes the skipped windows after the drive.
        """
        if not self.capturing or len(self._inbox) < 2:
            return
        waited_s = (self._now_ns() - self._inbox[0].primary[-1].frame.t_ns) / 1e9
        if not self.pose_lost and waited_s + self._took_s <= IN_TIME_S:
            return
        *late, newest = self._inbox
        if not self.overtaken:
            # reported once; the status has their number
            self._say("too slow for live poses: windows are skipped, run calm-edge map later")
        self.overtaken += len(late)
        for window in late:
            self.leave_to_map(window)
        self._inbox = deque([newest])

    def _spawn(self) -> Child:
        return Child("estimator", run_estimator, (self._config, self._lockstep), self._events)

    def _replace(self) -> None:
        """Count what was lost with a dead process; restart it unless it died too often in a row."""
        self._deaths_in_a_row += 1
        self._ready = False
        self._sent.clear()
        self._died_finishing = self._finishing
        what = f"estimator died (exit {self.child.exit_code})"
        if self._in_hand is not None:
            self.lost.append(self._in_hand)
            what += f", window {self._in_hand} lost with it"
            self._in_hand = None
        if self.given_up:
            self._say(f"{what}; not restarted, recording continues: run calm-edge map later")
            self.lost += [w.submap_id for w in self._inbox]
            self._inbox.clear()
            return
        self._say(f"{what}; restarted, recording continues")
        self.restarts += 1
        self.child = self._spawn()
        if not self._make_depth:
            self.child.send(MakeDepth(False))
