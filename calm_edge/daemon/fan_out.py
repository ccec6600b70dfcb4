"""Distribute live results to all outputs, isolated from each other: a slow one delays no other."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from calm_edge.daemon.health import Health
from calm_edge.daemon.messages import Attached, Event, Keep
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing
from calm_edge.recording.mailbox import Mailbox
from calm_edge.recording.sensors import Sample
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import Float32, LocalizerUpdate, PoseSample
from device.frame import Frame

log = logging.getLogger(__name__)

# size in an output's queue of a message that is neither a frame nor an update
MESSAGE_BYTES = 1024
# time for an output to process its queue at the end of a run
CLOSE_S = 1.0
# an exception is reported as a fault for this time
FAULT_S = 10.0

Call = Callable[["Output"], object]


class Output:
    """Base class of a consumer of live results; a subclass overrides the methods it needs.

    The methods are called from a separate thread with a queue of `queue_bytes`; when the queue is
    full its oldest message is dropped. If a method raises, that message is lost and counted.
    Arguments must not be modified.

    immediate: the methods do not block and are called by the capture loop, without a queue.
    required: an exception ends the run.
    wants_frames: whether `frame` is to be called at present; frames are the most of all messages.
    """

    name = "output"
    immediate = required = False
    wants_frames = True
    queue_bytes = 16 << 20

    @property
    def lost(self) -> int:
        """Number of messages that the output itself has dropped."""
        return 0

    @property
    def fault(self) -> str:
        """Reason why the output does not work at present; empty if it does."""
        return ""

    def frame(self, frame: Frame) -> None:
        """Take a frame of either camera, as JPEG bytes."""

    def sample(self, sample: Sample) -> None:
        """Take a GPS fix or an IMU sample."""

    def window(self, window: WindowRecord) -> None:
        """Take the record of a completed window; replaces an earlier one of the same sub-map."""

    def pose(self, sample: PoseSample, now_ns: int) -> None:
        """Take a live pose. now_ns: the present, on the clock of the pose's stamp."""

    def moves(self, t_ns: int, moves: Float32) -> None:
        """Take the points that gave the pose of t_ns, as in `Posed`; about twice a second."""

    def update(self, update: LocalizerUpdate) -> None:
        """Take a new or moved sub-map, and the poses that changed with it."""

    def attached(self, attached: Attached) -> None:
        """Take the result of the tracker's attempt to localise against a sub-map."""

    def cameras(self, settings: Mapping[str, str]) -> None:
        """Take the settings of the cameras, once known and when changed.

        One JSON text each under `primary` and `assistant`; under `since_ns` the time of the change.
        """

    def status(self, standing: Standing, health: Health | None) -> None:
        """Take the state of the daemon, every second; health is None when the daemon stops."""

    def say(self, level: int, text: str, name: str) -> None:
        """Take a line of the log. level: as in Python's logging."""

    def event(self, event: Event) -> None:
        """Take a moment that somebody marked."""

    def keep(self, kept: bool) -> None:
        """Protect the drive from removal, or end that."""

    def requests(self) -> Sequence[Event | Keep]:
        """Take what people asked for through this output since the last call.

        Called by the capture loop: it must not block.
        """
        return ()

    def tick(self, now_ns: int) -> None:
        """Act on a cycle of the capture loop without a pose; called for immediate outputs only."""

    def close(self, result: RecordResult) -> None:
        """End the output with the run; result.error is the reason if the run failed."""


class FanOut:
    """Passes each result to all outputs of one run, in the given order."""

    def __init__(self, outputs: Sequence[Output]) -> None:
        self._guards = [Guard(o) if o.immediate else QueuedGuard(o) for o in outputs]

    def give(self, call: Call, size: int = MESSAGE_BYTES) -> None:
        """Call every output, at once or from its thread. size: of the message, bytes."""
        for guard in self._guards:
            guard.give(call, size)

    def frame(self, frame: Frame) -> None:
        """Give a frame to the outputs that want frames."""
        for guard in self._guards:
            if guard.output.wants_frames:
                guard.give(lambda output: output.frame(frame), len(frame.image))

    def tick(self, now_ns: int) -> None:
        """Notify immediate outputs of a cycle of the capture loop without a pose."""
        for guard in self._guards:
            if guard.output.immediate:
                guard.give(lambda output: output.tick(now_ns), 0)

    def requests(self) -> Iterator[Event | Keep]:
        """Yield what people asked for through the outputs since the last call."""
        for guard in self._guards:
            yield from guard.output.requests()

    def lost(self) -> dict[str, int]:
        """Number of messages lost so far by each output that is not `required`, by name."""
        return {g.output.name: g.lost for g in self._guards if not g.output.required}

    def faults(self) -> Iterator[str]:
        """Yield one line of text for each output that does not work at present."""
        yield from filter(None, (guard.fault for guard in self._guards))

    def close(self, result: RecordResult) -> None:
        """Close the outputs, the first one last: `result` then holds the losses of the others."""
        for guard in reversed(self._guards):
            guard.close(result)
            result.output_losses = self.lost()


class Guard:
    """An immediate output, with the number of its exceptions and the latest one."""

    def __init__(self, output: Output) -> None:
        self.output = output
        self._failed, self._failed_s = 0, -math.inf
        self._error = ""

    @property
    def lost(self) -> int:
        return self.output.lost + self._failed

    @property
    def fault(self) -> str:
        recent = time.monotonic() - self._failed_s < FAULT_S
        return self._error if recent else self.output.fault

    def give(self, call: Call, size: int) -> None:
        """Call the output now."""
        self._make(call)

    def close(self, result: RecordResult) -> None:
        """Close the output."""
        if not self.output.required and self.fault:
            result.output_faults.append(self.fault)
        self._make(lambda output: output.close(result))

    def _make(self, call: Call) -> None:
        try:
            call(self.output)
        except Exception as error:
            if self.output.required:
                raise
            if not self._failed:
                log.exception("%s; further exceptions are only counted", self.output.name)
            self._failed += 1
            self._failed_s = time.monotonic()
            self._error = f"{self.output.name}: {error!r}"


class QueuedGuard(Guard):
    """An output that may block, with a queue and a thread that calls it."""

    def __init__(self, output: Output) -> None:
        super().__init__(output)
        self._mailbox: Mailbox[Call] = Mailbox(output.queue_bytes)
        self._thread = threading.Thread(target=self._run, name=output.name, daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        return super().lost + sum(self._mailbox.dropped)

    def give(self, call: Call, size: int) -> None:
        """Queue the call for the thread."""
        self._mailbox.put(call, size, False)

    def close(self, result: RecordResult) -> None:
        """Close the output after its queued calls; calls not made within CLOSE_S are dropped."""
        if self.fault:
            result.output_faults.append(self.fault)
        self._mailbox.put(lambda output: output.close(result), 0, False)
        self._mailbox.close()
        self._thread.join(CLOSE_S)
        self._mailbox.clear()
        # a call that has not returned counts as failed
        self._failed += self._thread.is_alive()

    def _run(self) -> None:
        while True:
            call = self._mailbox.take(CLOSE_S)
            if call is not None:
                self._make(call)
            elif self._mailbox.closed:
                return
