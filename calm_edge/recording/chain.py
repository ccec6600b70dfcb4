"""One segment after the other on a disk that may fill, fail and come back."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from calm_edge.config import RecordingConfig
from calm_edge.recording import schema
from calm_edge.recording.room import Room
from calm_edge.recording.schema import LogMessage
from calm_edge.recording.segment import Segment, Write
from calm_edge.recording.space import Space

_log = logging.getLogger(__name__)


class SegmentChain:
    """Owner of the segment being written and of what a failing disk has not taken yet.

    After the first `open` nothing here raises OSError: a disk that fails is told in `error` and
    to `on_error` (empty text: all is well again), and what it did not take is carried to the next
    segment. root: see Room.
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
    ) -> None:
        self._folder, self._config, self._metadata = folder, config, dict(metadata)
        self._now_ns, self._write, self._on_error = now_ns, write, on_error
        self._room = Room(folder, config, root)
        self._segment: Segment | None = None
        self._number = 0
        self._closed_messages = self._closed_bytes = 0
        self._carried: list[LogMessage] = []
        self.error = ""
        self.sync_ms = 0.0

    @property
    def is_open(self) -> bool:
        """A segment is being written."""
        return self._segment is not None

    @property
    def kept(self) -> int:
        """Messages that are in a file."""
        segment = self._segment
        return self._closed_messages + (segment.kept_messages if segment is not None else 0)

    @property
    def space(self) -> Space:
        """The disk when it was looked at last."""
        return self._room.space

    def open(self) -> None:
        """Begins the next segment; raises OSError."""
        self._segment = self._begin()

    def put(self, messages: list[LogMessage]) -> None:
        """Into the segment, or carried until there is one."""
        for i, message in enumerate(messages):
            if self._segment is None:
                self._carried += messages[i:]
                return
            try:
                self._segment.write(message, time.monotonic_ns())
            except OSError as error:
                self.fail(_reason(error))

    def describe(self, name: str, values: dict[str, str]) -> None:
        """Metadata into the segment and into each that follows."""
        self._metadata[name] = values
        if self._segment is None:
            return
        try:
            self._segment.describe(name, values)
        except OSError as error:
            self.fail(_reason(error))

    def settle(self) -> None:
        """Into the file and on its way to the disk; then ends a segment that is long enough, or
        that has no more room.
        """
        if self._segment is None:
            return
        try:
            self._segment.sync_behind()
            self.sync_ms = self._segment.sync_ms
        except OSError as error:
            self.fail(_reason(error))
            return
        if not self._look():
            self.finish()
            self._report("No space left on device above what has to stay free")
        elif time.monotonic() - self._opened_at >= self._config.segment_s:
            self.finish()

    def finish(self) -> None:
        """Ends the segment whole."""
        if self._segment is None:
            return
        try:
            self._segment.finish()
            self._let_go(self._segment)
        except OSError as error:
            self.fail(_reason(error))

    def fail(self, reason: str) -> None:
        """Ends the segment where it is good, keeps the rest for the next one."""
        if self._segment is not None:
            self._carried += self._segment.abandon()
            self._let_go(self._segment)
        self._report(reason)

    def try_again(self) -> bool:
        """Begins the next segment with what was carried; False when the disk does not take it."""
        if self.error and not self._room.has_come_back():
            return False
        try:
            segment = self._begin()
        except OSError as error:
            self._report(_reason(error))
            return False
        try:
            for message in self._carried:
                segment.write(message, time.monotonic_ns())
            segment.sync()
        except OSError as error:
            segment.discard()
            self._report(_reason(error))
            return False
        self._carried = []
        self._segment = segment
        if self.error:
            _log.warning("%s: recording again", self._folder)
        self.error = ""
        self._on_error("")
        return True

    def drop_carried(self) -> int:
        """Gives up what the disk did not take; how many messages."""
        dropped, self._carried = len(self._carried), []
        return dropped

    def _begin(self) -> Segment:
        try:
            segment = self._next_segment()
        except FileExistsError:
            # an earlier try failed, and so did removing what it left: that is not the fault to tell
            self._number += 1
            segment = self._next_segment()
        self._number += 1
        self._opened_at = time.monotonic()
        return segment

    def _next_segment(self) -> Segment:
        chunk_bytes = self._config.chunk_bytes
        return Segment(self._folder, self._number, chunk_bytes, self._metadata, self._write)

    def _look(self) -> bool:
        """Whether the disk has room for more; says what was removed for it."""
        segment_bytes = self._segment.size if self._segment is not None else 0
        enough = self._room.look(time.monotonic(), self._closed_bytes + segment_bytes)
        for path in self._room.take_removed():
            text = f"{path}: removed, the oldest not kept, to make room"
            self.put([schema.log_message(self._now_ns(), logging.INFO, text, "recording")])
            _log.info("%s", text)
        return enough

    def _let_go(self, segment: Segment) -> None:
        self._closed_messages += segment.kept_messages
        self._closed_bytes += segment.size
        self._segment = None

    def _report(self, reason: str) -> None:
        self.error = f"{self._folder}: {reason}; free space or mend the disk, it is tried again"
        self._on_error(self.error)
        _log.error("%s", self.error)


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
