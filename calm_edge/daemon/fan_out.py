"""Hand live results to every output; a slow or failing one loses its own messages only."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence

from calm_edge.daemon.health import Health
from calm_edge.daemon.messages import Attached
from calm_edge.daemon.result import RecordResult
from calm_edge.daemon.state import Standing
from calm_edge.recording.mailbox import Mailbox
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import LocalizerUpdate, PoseSample
from device.frame import Frame

log = logging.getLogger(__name__)

# size of a message other than a frame or an update, in a queue
MESSAGE_BYTES = 1024
# for an output to take what is left in its queue
CLOSE_S = 1.0
# how long an exception is reported as a fault
FAULT_S = 10.0

Call = Callable[["Output"], object]


class Output:
    """A consumer of live results; it overrides the methods it has use for.

    They are called on a thread of the output's own, behind a queue of `queue_bytes` from which the
    oldest message is dropped when it is full. An exception costs the message and is counted.

    immediate: they return at once, and are called by the capture loop itself. required: an
    exception ends the run. What is handed over must not be changed.
    """

    name = "output"
    immediate = required = False
    queue_bytes = 16 << 20

    @property
    def lost(self) -> int:
        """Messages lost in a queue of its own."""
        return 0

    @property
    def fault(self) -> str:
        """Why it does not work at present, or empty."""
        return ""

    def frame(self, frame: Frame) -> None:
        """A frame of either camera, as JPEG bytes."""

    def window(self, window: WindowRecord) -> None:
        """A completed window; of two records of one sub-map the later one holds."""

    def pose(self, sample: PoseSample, now_ns: int) -> None:
        """A live pose; now_ns is on the clock of its stamp."""

    def update(self, update: LocalizerUpdate) -> None:
        """A sub-map, and the poses that changed with it."""

    def attached(self, attached: Attached) -> None:
        """The tracker has tried to localise against a sub-map."""

    def cameras(self, settings: Mapping[str, str]) -> None:
        """Camera settings as JSON by eye, and since_ns; again when they change."""

    def status(self, standing: Standing, health: Health | None) -> None:
        """State of the daemon: every second with its figures, and without when it stops."""

    def say(self, level: int, text: str, name: str) -> None:
        """A line of the log; level as in Python's logging."""

    def tick(self, now_ns: int) -> None:
        """A cycle of the capture loop without a pose; called for immediate outputs only."""

    def close(self, result: RecordResult) -> None:
        """The run has ended; result.error is the reason if it failed."""


class FanOut:
    """Owner of the outputs of one run, in the order they are served."""

    def __init__(self, outputs: Sequence[Output]) -> None:
        self._guards = [Guard(o) if o.immediate else QueuedGuard(o) for o in outputs]

    def give(self, call: Call, size: int = MESSAGE_BYTES) -> None:
        """Call every output, at once or from its queue; size [bytes] of what is handed over."""
        for guard in self._guards:
            guard.give(call, size)

    def tick(self, now_ns: int) -> None:
        """To be called in each cycle of the capture loop without a pose."""
        for guard in self._guards:
            if guard.output.immediate:
                guard.give(lambda output: output.tick(now_ns), 0)

    def lost(self) -> dict[str, int]:
        """Messages lost so far by each output but the required ones, which count their own."""
        return {g.output.name: g.lost for g in self._guards if not g.output.required}

    def faults(self) -> Iterator[str]:
        """A line for each output that does not work at present."""
        yield from filter(None, (guard.fault for guard in self._guards))

    def close(self, result: RecordResult) -> None:
        """Close the outputs, the first one last, when result has the losses of all others."""
        for guard in reversed(self._guards):
            guard.close(result)
            result.output_losses = self.lost()


class Guard:
    """An immediate output, and how often it failed."""

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
        """Make the call."""
        self._make(call)

    def close(self, result: RecordResult) -> None:
        """Close the output."""
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
    """An output that may be slow, with its queue and thread."""

    def __init__(self, output: Output) -> None:
        super().__init__(output)
        self._mailbox: Mailbox[Call] = Mailbox(output.queue_bytes)
        self._thread = threading.Thread(target=self._run, name=output.name, daemon=True)
        self._thread.start()

    @property
    def lost(self) -> int:
        return super().lost + sum(self._mailbox.dropped)

    def give(self, call: Call, size: int) -> None:
        """Queue the call."""
        self._mailbox.put(call, size, False)

    def close(self, result: RecordResult) -> None:
        """Close the output after what is queued; drop that after CLOSE_S."""
        self._mailbox.put(lambda output: output.close(result), 0, False)
        self._mailbox.close()
        self._thread.join(CLOSE_S)
        self._mailbox.clear()
        # what it is still busy with
        self._failed += self._thread.is_alive()

    def _run(self) -> None:
        while True:
            call = self._mailbox.take(CLOSE_S)
            if call is not None:
                self._make(call)
            elif self._mailbox.closed:
                return
