"""Write a recording in a thread of its own, behind a bounded queue.

If the process is killed, at most one chunk or the time since the last flush is lost. A full or
failing disk is reported and never blocks the caller.
"""

from __future__ import annotations

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import calm_edge
from calm_edge.config import Config
from calm_edge.recording import RecordingError, plots, schema
from calm_edge.recording.chain import SegmentChain
from calm_edge.recording.display import Display
from calm_edge.recording.health import WriterHealth, boot_id
from calm_edge.recording.mailbox import Mailbox
from calm_edge.recording.record import array_bytes
from calm_edge.recording.retention import is_kept, set_kept
from calm_edge.recording.schema import LogMessage
from calm_edge.recording.segment import Write, segment_files
from calm_edge.recording.sensors import Sample, messages
from calm_edge.recording.time_base import TimeBase
from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import Float, LocalizerUpdate, PoseSample
from device.frame import Frame

RETRY_S = 1.0

_Encode = Callable[[], list[LogMessage]]
# time of arrival, and how to encode what has arrived
_Item = tuple[int, _Encode]
_log = logging.getLogger(__name__)


class RecordingWriter:
    """Writer of one recording folder; every `write_*` queues its argument and returns at once.

    metadata: texts about the session (backbone, camera identities ...). now_ns: clock of the
    frames. lossless: `write_*` waits for room instead of dropping, and raises RecordingError if
    the disk fails; no message depends on the time of writing. root: folder of all drives, the
    oldest of which are removed to make room. time_base: of the frames. Arguments must not be
    changed after the call. Raises RecordingError if the folder already holds a recording or cannot
    be written.
    """

    def __init__(
        self,
        folder: Path,
        config: Config,
        metadata: Mapping[str, str] | None = None,
        *,
        lossless: bool = False,
        root: Path | None = None,
        time_base: TimeBase | None = None,
        queue_bytes: int = 128 << 20,
        now_ns: Callable[[], int] = time.monotonic_ns,
        write: Write = os.write,
    ) -> None:
        self._config, self._now_ns = config, now_ns
        time_base = time_base or TimeBase()
        self._origin_ns = time_base.origin_ns
        self._display = Display(config.pose_output, self._origin_ns)
        session = {
            schema.CONFIG_METADATA: {"json": json.dumps(config.to_dict())},
            schema.SESSION_METADATA: {
                "version": calm_edge.__version__,
                "backbone": config.backbone.name,
                "boot_id": boot_id(),
                schema.END_KEY: "marked",
                **time_base.metadata(),
                **(metadata or {}),
            },
        }
        self._mailbox: Mailbox[_Item] = Mailbox(queue_bytes, lossless)
        self._lossless = lossless
        self._folder, self._kept = folder, is_kept(folder)
        self._unwritable = self._reported_drops = 0
        self._chain = SegmentChain(
            folder,
            config.recording,
            session,
            now_ns,
            write,
            self._mailbox.set_broken,
            root,
            timeless=lossless,
            time_base=time_base,
        )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if segment_files(folder):
                raise RecordingError(
                    f"{folder}: already holds a recording; choose another output folder"
                )
            self._chain.open()
        except OSError as error:
            raise RecordingError(
                f"{folder}: cannot be written ({error.strerror}); choose another output folder"
            ) from None
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def health(self) -> WriterHealth:
        """Current state of the writer; may be called from any thread."""
        others, images = self._mailbox.dropped
        chain = self._chain
        return WriterHealth(
            chain.error,
            images,
            others,
            self._unwritable,
            self._mailbox.fill,
            chain.sync_ms,
            chain.space,
            self._kept,
        )

    def write_frame(self, frame: Frame) -> None:
        """Record an encoded frame of either eye."""
        origin_ns = self._origin_ns
        self._put(lambda: [schema.frame_message(frame, origin_ns)], len(frame.image), True)

    def write_sample(self, sample: Sample) -> None:
        """Record a GPS fix or an IMU sample."""
        origin_ns = self._origin_ns
        self._put(lambda: messages(sample, origin_ns), 512)

    def write_pose(self, sample: PoseSample) -> None:
        """Record a live pose."""
        self._put(lambda: [schema.pose_message(sample), *self._display.pose(sample)], 1024)

    def write_update(self, update: LocalizerUpdate) -> None:
        """Record the update of a sub-map and the poses it changed.

        Depth is recorded only with recording.log_depth.
        """
        log_depth = self._config.recording.log_depth
        size = array_bytes(update)

        def encode() -> list[LogMessage]:
            stored = schema.update_message(update, log_depth, self._display.time_of(update))
            return [stored, *self._display.update(update)]

        self._put(encode, size)

    def write_odometry_frame(self, T_map_odom: Float) -> None:
        """Take the pose (4, 4) of the tracker's odometry frame for the poses that follow."""

        def encode() -> list[LogMessage]:
            self._display.T_map_odom = T_map_odom
            return []

        self._put(encode, 1024)

    def write_window(self, record: WindowRecord) -> None:
        """Record the frames of a window; a later record of the same sub-map replaces it."""
        self._put(lambda: [schema.window_message(record)], 1024)

    def write_log(self, level: int, message: str, name: str = "calm-edge") -> None:
        """Record a log line; level as in Python's logging."""
        now = self._now_ns()
        self._put(lambda: [self._log_message(now, level, message, name)], 512)

    def write_status(self, status: Mapping[str, Any], topic: str = schema.STATUS) -> None:
        """Record a JSON object on /status or /health."""
        now, copy = self._now_ns(), dict(status)

        def encode() -> list[LogMessage]:
            return [schema.json_message(topic, now, copy), *plots.messages(topic, now, copy)]

        self._put(encode, 2048)

    def write_event(self, t_ns: int, text: str) -> None:
        """Record a moment that somebody marked."""
        self._put(lambda: [schema.json_message(schema.EVENT, t_ns, {"text": text})], 512)

    def keep(self, kept: bool) -> None:
        """Protect the drive from removal, or end that, as `calm-edge keep` does; log it."""

        def mark() -> list[LogMessage]:
            text, level = "the drive is protected from removal", logging.INFO
            try:
                set_kept(self._folder, kept)
                self._kept = kept
                text = text if kept else "the drive is no longer protected from removal"
            except RecordingError as error:
                text, level = f"cannot be protected: {error}", logging.ERROR
            return [self._log_message(self._now_ns(), level, text)]

        self._put(mark, 512)

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Record texts about the session; a later call with the same name replaces them."""
        copy = dict(values)

        def write() -> list[LogMessage]:
            self._chain.write_metadata(name, copy)
            return []

        self._put(write, 512)

    def _put(self, encode: _Encode, size: int, is_image: bool = False) -> None:
        self._mailbox.put((self._now_ns(), encode), size, is_image)

    def _log_message(
        self, now_ns: int, level: int, message: str, name: str = "recording"
    ) -> LogMessage:
        return schema.log_message(now_ns, level, message, name, self._origin_ns)

    def close(self) -> WriterHealth:
        """Write the queued items, finish the segment, return the last state. Idempotent."""
        self._mailbox.close()
        self._thread.join()
        return self.health

    # all methods below run in the writer's thread

    def _run(self) -> None:
        while True:
            try:
                self._loop()
                return
            except Exception as error:
                # continue recording without the messages that may have caused the error
                _log.exception("error in the recording thread; recording continues")
                self._chain.fail(f"error in the writer: {error!r}")
                self._unwritable += self._chain.drop_unwritten()
                if self._mailbox.wait_closed(RETRY_S):
                    self._give_up()
                    return

    def _loop(self) -> None:
        next_tick = time.monotonic()
        while True:
            if not self._chain.is_open and not self._chain.reopen():
                if self._mailbox.wait_closed(RETRY_S):
                    self._give_up()
                    return
                continue
            item = self._mailbox.take(max(0.0, next_tick - time.monotonic()))
            if item is not None:
                self._write_item(*item)
            elif self._mailbox.closed:
                break
            if time.monotonic() >= next_tick:
                next_tick = time.monotonic() + self._config.recording.flush_s
                self._tick()
        self._chain.write_metadata(schema.END_METADATA, {"segments": str(self._chain.number)})
        self._chain.finish()
        self._give_up()

    def _write_item(self, arrived_ns: int, encode: _Encode) -> None:
        try:
            messages = encode()
        except Exception as error:
            # an item that cannot be encoded must not end the recording
            self._unwritable += 1
            now = self._now_ns()
            text = f"one item could not be recorded: {error}"
            messages = [self._log_message(now, logging.ERROR, text)]
            _log.error("%s", text)
        self._chain.write(messages, arrived_ns)

    def _tick(self) -> None:
        """Run every flush_s: record clock reading and drops, sync, check the disk."""
        now = self._now_ns()
        # what waits for its writer has no relation to the clocks of the host
        messages = []
        if not self._lossless:
            messages.append(schema.clock_message(now, time.time_ns(), time.monotonic_ns()))
        dropped = sum(self._mailbox.dropped)
        if dropped > self._reported_drops:
            text = f"queue full: {dropped - self._reported_drops} items not recorded"
            messages.append(self._log_message(now, logging.WARNING, text))
            _log.warning("%s", text)
            self._reported_drops = dropped
        self._chain.write(messages, now)
        self._chain.sync()
        # by `calm-edge keep` too
        self._kept = is_kept(self._folder)

    def _give_up(self) -> None:
        """On closing, discard and count the messages that could not be written."""
        self._unwritable += self._chain.drop_unwritten()
        self._mailbox.clear()
