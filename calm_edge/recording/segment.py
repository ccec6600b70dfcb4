"""Write one MCAP file: `NNNN.mcap.part`, renamed to `NNNN.mcap` when it is finished."""

from __future__ import annotations

import os
import re
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

from mcap.writer import CompressionType, Writer

from calm_edge.recording import RecordingError
from calm_edge.recording.schema import TOPICS, LogMessage, topic_schema
from device.atomic_file import sync_folder

PART = ".part"
_NAME = re.compile(r"(\d{4,})\.mcap(\.part)?")

Write = Callable[[int, bytes], int]


def segment_files(folder: Path) -> list[Path]:
    """List the finished and unfinished segments of a folder in order; raises RecordingError."""
    try:
        found = [(m, p) for p in folder.iterdir() if (m := _NAME.fullmatch(p.name))]
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be read ({error.strerror})") from None
    return [p for _, p in sorted(found, key=lambda f: (int(f[0][1]), f[1].name))]


def recording_files(path: Path) -> list[Path]:
    """List the segments of a recording folder, or the one file given; raises RecordingError."""
    try:
        files = segment_files(path) if path.is_dir() else [path]
        missing = not path.exists()
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
    if missing:
        raise RecordingError(f"{path}: no such recording; name a recording folder or MCAP file")
    if not files:
        pictures = any((path / name).is_dir() for name in ("cam0", "mav0"))
        remedy = "make one with record --sequence" if pictures else "name another folder"
        raise RecordingError(f"{path}: holds no recording (NNNN.mcap); {remedy}")
    return files


def missing_segments(files: Sequence[Path]) -> list[str]:
    """One line for each run of numbers that the segments of one folder, in order, leave out."""
    lines, expected = [], 0
    for file in files:
        number = int(file.name.partition(".")[0])
        if number > expected:
            last = f" to {number - 1:04d}.mcap" if number - 1 > expected else ""
            lines.append(
                f"{file.with_name(f'{expected:04d}.mcap')}{last}: missing; copy the folder again, "
                "unless it was removed to make room"
            )
        expected = number + 1
    return lines


class _Sink:
    """An unbuffered file that writes everything or raises, and counts the bytes written."""

    def __init__(self, fd: int, write: Write) -> None:
        self._fd, self._write = fd, write
        self.position: int = 0

    def write(self, data: bytes) -> int:
        rest = memoryview(data)
        while rest:
            n = self._write(self._fd, cast(bytes, rest))
            self.position += n
            rest = rest[n:]
        return len(data)

    def tell(self) -> int:
        return self.position

    def flush(self) -> None:
        """Do nothing: there is no buffer."""


class Stamped(NamedTuple):
    """A message with its times in the file, Unix time in ns."""

    message: LogMessage
    log_ns: int
    publish_ns: int


class Segment:
    """An unfinished segment file, used by one thread; methods may raise OSError.

    kept_messages: number of messages in chunks already written to the file; `abandon` returns the
    messages after those.
    """

    def __init__(
        self,
        folder: Path,
        number: int,
        chunk_bytes: int,
        metadata: Mapping[str, dict[str, str]],
        write: Write = os.write,
    ) -> None:
        self.target = folder / f"{number:04d}.mcap"
        self.path = self.target.with_name(self.target.name + PART)
        self._fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._sink = _Sink(self._fd, write)
        self._pending: list[Stamped] = []
        self._kept_bytes = 0
        self._syncing: threading.Thread | None = None
        self._sync_error: OSError | None = None
        self.sync_ms = 0.0
        self.kept_messages = 0
        try:
            self._writer: Any = Writer(
                cast(IO[Any], self._sink), chunk_bytes, compression=CompressionType.NONE
            )
            self._writer.start(library="calm-edge")
            for name, values in metadata.items():
                self._writer.add_metadata(name, _utf8(values))
            self._channels = {topic: self._register(topic) for topic in TOPICS}
            sync_folder(folder)
        except OSError:
            self.discard()
            raise

    def _register(self, topic: str) -> int:
        schema = topic_schema(topic)
        schema_id = self._writer.register_schema(schema.name, schema.encoding, schema.data)
        return int(self._writer.register_channel(topic, schema.message_encoding, schema_id))

    def write(self, stamped: Stamped) -> None:
        """Add a message to the current chunk, which is written to the file when it is full."""
        before = self._sink.position
        self._pending.append(stamped)
        message = stamped.message
        self._writer.add_message(
            self._channels[message.topic],
            stamped.log_ns,
            message.data,
            stamped.publish_ns,
            message.sequence & 0xFFFFFFFF,
        )
        if self._sink.position != before:
            self._keep()

    def write_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record to the file at once."""
        self.flush()
        self._writer.add_metadata(name, _utf8(values))
        self._keep()

    def flush(self) -> None:
        """Write all messages to the file: safe if the process is killed, but not at a power cut."""
        self._writer.flush()
        self._keep()

    def sync(self) -> None:
        """Write all messages to the file and sync it to the disk."""
        self.flush()
        os.fdatasync(self._fd)

    def sync_in_background(self) -> None:
        """Write all messages to the file, and sync it to the disk in another thread.

        Syncing can take seconds, during which new messages would be held in memory. Raises the
        OSError of an earlier call.
        """
        self.flush()
        if self._sync_error is not None:
            error, self._sync_error = self._sync_error, None
            raise error
        if self._syncing is None or not self._syncing.is_alive():
            # duplicated, as the segment may be closed while the thread syncs
            copy = os.dup(self._fd)
            self._syncing = threading.Thread(target=self._sync_copy, args=(copy,), daemon=True)
            self._syncing.start()

    def _sync_copy(self, fd: int) -> None:
        started = time.monotonic()
        try:
            os.fdatasync(fd)
        except OSError as error:
            self._sync_error = error
        finally:
            os.close(fd)
        self.sync_ms = 1e3 * (time.monotonic() - started)

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._sink.position

    def finish(self) -> Path:
        """Complete and close the file; return its final path, to which it is renamed."""
        self.sync()
        self._writer.finish()
        os.fdatasync(self._fd)
        os.close(self._fd)
        self._fd = -1
        self.path.rename(self.target)
        sync_folder(self.target.parent)
        return self.target

    def abandon(self) -> list[Stamped]:
        """After an OSError: truncate the file to its last complete chunk and leave it as `.part`.

        Returns the messages after that chunk. A file without messages is removed. Never raises.
        """
        if self._fd >= 0:
            with suppress(OSError):
                os.ftruncate(self._fd, self._kept_bytes)
                os.fdatasync(self._fd)
            with suppress(OSError):
                os.close(self._fd)
            self._fd = -1
        if self.kept_messages == 0:
            self.discard()
        return self._pending

    def discard(self) -> None:
        """Remove the unfinished file. Never raises."""
        if self._fd >= 0:
            with suppress(OSError):
                os.close(self._fd)
            self._fd = -1
        with suppress(OSError):
            self.path.unlink()

    def _keep(self) -> None:
        self.kept_messages += len(self._pending)
        self._pending.clear()
        self._kept_bytes = self._sink.position


def _utf8(values: Mapping[str, str]) -> dict[str, str]:
    """Replace in texts what is not UTF-8, as names of files may hold."""
    return {key: text.encode(errors="backslashreplace").decode() for key, text in values.items()}
