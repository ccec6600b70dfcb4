"""Program of the estimator process: computes sub-maps, with dense depth if configured."""

from __future__ import annotations

import dataclasses
import logging
import os
import sys
import time
import traceback
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from calm_edge.backbones.base import ExpectsPictures
from calm_edge.backbones.registry import open_backbone
from calm_edge.config import Config
from calm_edge.daemon.child import serve
from calm_edge.daemon.messages import (
    Expect,
    Finish,
    Finished,
    MakeDepth,
    Process,
    Processed,
    Ready,
    Refused,
    Stop,
)
from calm_edge.daemon.received_frames import ReceivedFrames
from calm_edge.estimator.localizer import Localizer
from calm_edge.frontend.diagnosis import of_frames
from calm_edge.posegraph.optimiser import Immediate, Optimiser, Spawned
from calm_edge.processes import follow_parent
from calm_edge.recording.window_record import of_window, window_hints
from calm_edge.types import CalmEdgeError, LocalizerUpdate, SubmapWindow
from device.frame import UnreadableImage

# Value for /proc/self/oom_score_adj, see proc(5): above 0, the default of the capture process.
OOM_SCORE_ADJ = "500"
# Switch interval of the interpreter (sys.setswitchinterval): with the default of 5 ms the threads
# of network and solver would wait for the interpreter lock.
SWITCH_S = 3e-4
# At the end of a live drive, time for solving windows again from their pictures; `calm-edge map`
# does the rest.
SOLVE_AGAIN_S = 5.0


class EstimatorWork:
    """Localizer and backbone; handles the messages of the capture process in order.

    unhurried: the capture process waits for every window; else windows are solved again from their
    pictures only when no other is expected meanwhile.
    """

    def __init__(self, config: Config, optimiser: Optimiser, *, unhurried: bool) -> None:
        self._config = config
        self._make_depth = config.recording.log_depth
        self._backbone = open_backbone(config)
        self._localizer = Localizer(
            config, self._backbone, optimiser=optimiser, unhurried=unhurried
        )
        self._unhurried = unhurried
        # on time.monotonic: arrival of the newest window, and of the next at the same pace
        self._arrived_s = self._next_s = -np.inf
        self._took_s = 0.0
        self._received = ReceivedFrames()

    @property
    def expects_pictures(self) -> bool:
        """Whether the backbone computes features of a keyframe (Expect) before its window."""
        return isinstance(self._backbone, ExpectsPictures) and self._backbone.expects_pictures

    def handle(self, message: Any) -> Any:
        """Handle one message; return the answer, or None if it needs none."""
        if isinstance(message, Process):
            for left_out in message.left_out:
                self._localizer.leave_out(left_out.submap_id, np.array(left_out.t_ns, np.int64))
            start_s = time.monotonic()
            self._arrived_s, self._next_s = start_s, 2 * start_s - self._arrived_s
            answer = self._process(self._received.window(message))
            self._took_s = time.monotonic() - start_s
            return answer
        if isinstance(message, Finish):
            trajectory = self._localizer.finish(np.inf if self._unhurried else SOLVE_AGAIN_S)
            localizer = self._localizer
            return Finished(
                localizer.submaps,
                trajectory,
                localizer.metre,
                localizer.solved_again,
                localizer.gaps,
                localizer.kit,
                localizer.masks,
            )
        if isinstance(message, Expect) and isinstance(self._backbone, ExpectsPictures):
            self._received.add(message.keyframe)
            # an unreadable image is reported later, when its window is processed
            with suppress(UnreadableImage):
                self._backbone.expect(message.keyframe.bgr())
        if isinstance(message, MakeDepth):
            self._make_depth = message.on and self._config.recording.log_depth
        return None

    def idle(self) -> bool:
        """Solve a window again from its pictures, if there is time for it; whether one was."""
        start_s = time.monotonic()
        if self._unhurried or start_s + self._took_s > self._next_s:
            return False
        try:
            found = self._localizer.solve_again()
        except Exception:
            # as in _process: a programming error must not end the process
            traceback.print_exc()
            return False
        if found:
            self._took_s = time.monotonic() - start_s
        return found

    def _process(self, window: SubmapWindow) -> Processed:
        try:
            update = self._localizer.process(window)
        except CalmEdgeError as error:
            return Processed(window.submap_id, None, str(error))
        except Exception as error:
            # a programming error must not end the process: report this window as unsolved
            traceback.print_exc()
            return Processed(window.submap_id, None, f"{type(error).__name__}: {error}")
        if update is None:
            found = of_frames(*([k.frame for k in e] for e in (window.primary, window.assistant)))
            reasons = [self._localizer.skipped[-1].reason, *(cause.text for cause in found)]
            metre = self._localizer.metre
            return Processed(window.submap_id, None, "; ".join(reasons), metre=metre)
        joined = update.loop_keyframe
        # the localizer may have added a loop keyframe to the window
        window = dataclasses.replace(window, loop_keyframe=joined)
        update = dataclasses.replace(update, loop_keyframe=None)
        if self._make_depth:
            update = self._densified(window, update)
        elif update.prediction.landmarks is not None:
            # depth that will not be recorded is not sent through the pipe
            light = dataclasses.replace(update.prediction, depth=None, confidence=None)
            update = dataclasses.replace(update, prediction=light)
        record = of_window(window) if joined is not None else None
        return Processed(window.submap_id, update, window=record, metre=update.metre)

    def _densified(self, window: SubmapWindow, update: LocalizerUpdate) -> LocalizerUpdate:
        start = time.perf_counter()
        images = [keyframe.frame.bgr() for keyframe in window.keyframes()]
        hints = window_hints(of_window(window), update, self._config)
        prediction = self._backbone.densify(images, hints, update.prediction)
        stage_ms = {**update.stage_ms, "densify": 1e3 * (time.perf_counter() - start)}
        return dataclasses.replace(update, prediction=prediction, stage_ms=stage_ms)


def _prefer_oom_kill() -> None:
    """Make the kernel kill this process and its children first when memory runs out.

    This process is restarted, whereas the capture process would lose data not yet written.
    """
    # the file exists on Linux only, and is read-only in some containers
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE_ADJ, encoding="ascii")


def run(connection: Connection, config: Config, lockstep: bool) -> None:
    """Main function of the process. lockstep: compute the joint optimum after every window."""
    follow_parent()
    # lower priority than capture and tracker, whose results are needed at once
    os.nice(10)
    _prefer_oom_kill()
    # no warnings: the capture process reports skipped windows
    logging.basicConfig(level=logging.ERROR)
    # all cores, at low priority; OpenCV's results do not depend on the number of threads
    cv2.setNumThreads(len(os.sched_getaffinity(0)))
    sys.setswitchinterval(SWITCH_S)
    try:
        optimiser = Immediate() if lockstep else Spawned()
        work = EstimatorWork(config, optimiser, unhurried=lockstep)
    except CalmEdgeError as error:
        connection.send(Refused(str(error)))
        return
    connection.send(Ready(work.expects_pictures))
    serve(connection, Stop, work.handle, idle=work.idle)
