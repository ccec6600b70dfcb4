"""Write a recording as a sequence of segment files, continuing after disk errors."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from calm_edge.config import RecordingConfig
from calm_edge.recording import schema
from calm_edge.recording.health import Space
from calm_edge.recording.room import Room
from calm_edge.recording.schema import LogMessage
from calm_edge.recording.segment import Segment, Stamped, Write
from calm_edge.recording.time_base import TimeBase

_log = logging.getLogger(__name__)


class SegmentChain:
    """Writer of one segment after another; keeps the messages that a disk error left unwritten.

    After the first `open` no method raises OSError: a disk error is stored in `error` and passed to
    `on_error` (an empty text: recovered), and messages not written go to the next segment. root:
    folder of all drives, the oldest of which are removed to make room; None: nothing is removed.
    timeless: messages are logged at their own time, not at that of their arrival. time_base: of the
    messages; their log times in the files never decrease.
    """

    def __init__(
        self,
        folder: Path,
        config: RecordingConfig,
        metadata: Mapping[str, dict[str, str]],
        now_ns: Callable[[], int],
        write: Write,
        on_error: Callable[[str], None],
        root: Path | None = None,
        *,
        timeless: bool = False,
        time_base: TimeBase | None = None,
    ) -> None:
        self._timeless, self._time_base = timeless, time_base or TimeBase()
        self._newest_log_ns = 0
        self._folder, self._config, self._metadata = folder, config, dict(metadata)
        self._now_ns, self._write, self._on_error = now_ns, write, on_error
        self._room = Room(folder, config, root)
        self._segment: Segment | None = None
        self._number = 0
        self._closed_bytes = 0
        self._unwritten: list[Stamped] = []
        self.error = ""
        self.sync_ms = 0.0

    @property
    def is_open(self) -> bool:
        """True while a segment is being written."""
        return self._segment is not None

    @property
    def number(self) -> int:
        """Number of the next segment."""
        return self._number

    @property
    def space(self) -> Space:
        """State of the disk when it was last checked."""
        return self._room.space

    def open(self) -> None:
        """Begin the next segment; raises OSError."""
        self._segment = self._begin()

    def write(self, messages: Iterable[LogMessage], arrived_ns: int) -> None:
        """Write to the segment, or keep the messages for the next one if none is open.

        arrived_ns: time of their arrival at the recorder, on the clock of the frames.
        """
        for message in messages:
            stamped = self._stamped(message, arrived_ns)
            if self._segment is None:
                self._unwritten.append(stamped)
                continue
            try:
                self._segment.write(stamped)
            except OSError as error:
                self.fail(_reason(error))

    def _stamped(self, message: LogMessage, arrived_ns: int) -> Stamped:
        epoch_ns = self._time_base.epoch_ns
        log_ns = epoch_ns + (message.t_ns if self._timeless else arrived_ns)
        # readers expect order: what is older than its predecessor takes the time of that
        self._newest_log_ns = log_ns = max(self._newest_log_ns, log_ns)
        return Stamped(message, log_ns, message.t_ns + epoch_ns)

    def write_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write metadata to the segment and to all that follow."""
        self._metadata[name] = values
        if self._segment is None:
            return
        try:
            self._segment.write_metadata(name, values)
        except OSError as error:
            self.fail(_reason(error))

    def sync(self) -> None:
        """Flush and start syncing; finish the segment if it is long enough or the disk is full.

        One without messages is not finished: a replay in lockstep may wait for minutes.
        """
        if self._segment is None:
            return
        try:
            self._segment.sync_in_background()
            self.sync_ms = self._segment.sync_ms
        except OSError as error:
            self.fail(_reason(error))
            return
        if not self._check_room():
            self.finish()
            self._report("No space left on device above what has to stay free")
        elif self._segment.kept_messages and self._is_old():
            self.finish()

    def _is_old(self) -> bool:
        return time.monotonic() - self._opened_at >= self._config.segment_s

    def finish(self) -> None:
        """Finish the open segment, if any."""
        if self._segment is None:
            return
        try:
            self._segment.finish()
            self._close(self._segment)
        except OSError as error:
            self.fail(_reason(error))

    def fail(self, reason: str) -> None:
        """Close the segment at its last complete chunk; later messages go to the next one."""
        if self._segment is not None:
            self._unwritten += self._segment.abandon()
            self._close(self._segment)
        self._report(reason)

    def reopen(self) -> bool:
        """Begin the next segment with the unwritten messages; False if the disk still fails."""
        if self.error and not self._room.can_resume():
            return False
        try:
            segment = self._begin()
        except OSError as error:
            self._report(_reason(error))
            return False
        try:
            for stamped in self._unwritten:
                segment.write(stamped)
            segment.sync()
        except OSError as error:
            segment.discard()
            # a number that is left out would be read as a lost segment
            self._number -= 1
            self._report(_reason(error))
            return False
        self._unwritten = []
        self._segment = segment
        if self.error:
            _log.warning("%s: recording resumed", self._folder)
        self.error = ""
        self._on_error("")
        return True

    def drop_unwritten(self) -> int:
        """Discard the messages that could not be written; return how many."""
        dropped, self._unwritten = len(self._unwritten), []
        return dropped

    def _begin(self) -> Segment:
        try:
            segment = self._next_segment()
        except FileExistsError:
            # the file of a failed attempt could not be removed: use the next number
            self._number += 1
            segment = self._next_segment()
        self._number += 1
        self._opened_at = time.monotonic()
        return segment

    def _next_segment(self) -> Segment:
        chunk_bytes = self._config.chunk_bytes
        return Segment(self._folder, self._number, chunk_bytes, self._metadata, self._write)

    def _check_room(self) -> bool:
        """Return False if the disk is too full to go on; log the segments removed to make room."""
        segment_bytes = self._segment.size if self._segment is not None else 0
        enough = self._room.check(time.monotonic(), self._closed_bytes + segment_bytes)
        for path in self._room.take_removed():
            text = f"{path}: removed to make room, as the oldest segment not marked to keep"
            now_ns, origin_ns = self._now_ns(), self._time_base.origin_ns
            line = schema.log_message(now_ns, logging.INFO, text, "recording", origin_ns)
            self.write([line], now_ns)
            _log.info("%s", text)
        return enough

    def _close(self, segment: Segment) -> None:
        self._closed_bytes += segment.size
        self._segment = None

    def _report(self, reason: str) -> None:
        # what waits for its writer is not retried: it ends
        then = "" if self._timeless else ", recording retries"
        self.error = f"{self._folder}: {reason}; free space or repair the disk{then}"
        self._on_error(self.error)
        _log.error("%s", self.error)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
