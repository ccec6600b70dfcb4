"""Check a recording, or rewrite the intact messages of a truncated one to a verified copy."""

from __future__ import annotations

import os
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

from mcap.records import Channel, Schema
from mcap.writer import CompressionType, Writer

from calm_edge.recording import RecordingError
from calm_edge.recording.scan import DamageError, SegmentIndex, plain_chunk, scan
from calm_edge.recording.schema import END_METADATA
from calm_edge.recording.segment import PART, missing_segments, recording_files


class Outcome(IntEnum):
    """Exit code of `recover` and `validate`."""

    ALL = 0
    FAILED = 1
    WITH_LOSS = 3


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """Result of `recover` or `validate`.

    messages: topic -> number of intact messages. losses: one line each; if FAILED, the reason.
    files: those read by `validate`, or written by `recover`.
    """

    outcome: Outcome
    messages: dict[str, int]
    losses: tuple[str, ...]
    files: tuple[Path, ...]


@dataclass(frozen=True, slots=True)
class _Message:
    channel: Channel
    schema: Schema | None
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


def default_target(source: Path) -> Path:
    """Default path of the copy: beside the source, with `-recovered` in its name."""
    name = source.name.removesuffix(PART).removesuffix(".mcap")
    return source.with_name(f"{name}-recovered" + ("" if source.is_dir() else ".mcap"))


def validate(path: Path) -> RecordingReport:
    """Check every chunk of a recording folder or file without writing; never raises."""
    messages: dict[str, int] = {}
    read: list[Path] = []
    try:
        files = recording_files(path)
    except RecordingError as error:
        return RecordingReport(Outcome.FAILED, {}, (str(error),), ())
    losses = missing_segments(files) if path.is_dir() else []
    for file in files:
        try:
            index = scan(file, check=True)
        except RecordingError as error:
            losses.append(str(error))
            continue
        losses += _losses(index, path, files)
        read.append(file)
        for topic, (n, _) in _digest(index).items():
            messages[topic] = messages.get(topic, 0) + n
    if not read:
        return RecordingReport(Outcome.FAILED, {}, tuple(losses), ())
    outcome = Outcome.WITH_LOSS if losses else Outcome.ALL
    return RecordingReport(outcome, messages, tuple(losses), tuple(read))


def recover(source: Path, target: Path) -> RecordingReport:
    """Copy all intact messages of `source` to `target`: a file to a file, a folder to a folder.

    The source is not changed. Each new file is read back and compared with its source, topic by
    topic. Raises RecordingError if the target exists; other failures are in the report.
    """
    if target.exists():
        raise RecordingError(f"{target}: exists already; name another target")
    messages: dict[str, int] = {}
    losses: list[str] = []
    written: list[Path] = []
    try:
        files = recording_files(source)
        if source.is_dir():
            target.mkdir(parents=True)
    except RecordingError as error:
        return RecordingReport(Outcome.FAILED, {}, (str(error),), ())
    except OSError as error:
        return RecordingReport(
            Outcome.FAILED, {}, (f"{target}: cannot be written ({error.strerror})",), ()
        )
    losses += missing_segments(files) if source.is_dir() else []
    for file in files:
        copy = target / file.name.removesuffix(PART) if source.is_dir() else target
        try:
            index = scan(file, check=True)
            if index.n_messages == 0 and (index.damaged or (index.cut and not index.data_ended)):
                losses += [*index.losses(), f"{file}: holds no intact message; not copied"]
                continue
            counts = _copy(index, copy)
        except RecordingError as error:
            losses.append(str(error))
            continue
        losses += _losses(index, source, files)
        written.append(copy)
        for topic, n in counts.items():
            messages[topic] = messages.get(topic, 0) + n
    if not written:
        return RecordingReport(Outcome.FAILED, messages, tuple(losses), ())
    outcome = Outcome.WITH_LOSS if losses else Outcome.ALL
    return RecordingReport(outcome, messages, tuple(losses), tuple(written))


def _losses(index: SegmentIndex, source: Path, files: list[Path]) -> list[str]:
    """Losses of one of the files of a recording, and of the end that the last one lacks."""
    is_last = source.is_dir() and index.path == files[-1]
    return [*index.losses(), *(index.missing_end() if is_last else [])]


def _messages(index: SegmentIndex) -> Iterator[_Message]:
    """Iterate over the messages of a checked file in order, one chunk in memory at a time."""
    columns = [
        (chunk, offset, size, index.channels[channel], sequence, log, publish)
        for channel, rows in index.rows.items()
        if channel in index.channels
        for chunk, offset, size, sequence, log, publish in zip(
            rows.chunk,
            rows.offset,
            rows.size,
            rows.sequence,
            rows.log_time,
            rows.publish_time,
            strict=True,
        )
    ]
    columns.sort(key=lambda row: row[:2])
    loaded, data = -1, b""
    try:
        with index.path.open("rb") as file:
            for chunk, offset, size, channel, sequence, log, publish in columns:
                if chunk != loaded:
                    file.seek(index.chunks[chunk].offset)
                    data = plain_chunk(file.read(index.chunks[chunk].size))
                    loaded = chunk
                payload = data[offset : offset + size]
                schema = index.schemas.get(channel.schema_id)
                yield _Message(channel, schema, sequence, log, publish, payload)
    except (DamageError, OSError) as error:
        raise RecordingError(
            f"{index.path}: changed while it was read ({error}); run it again"
        ) from None


def _digest(index: SegmentIndex) -> dict[str, tuple[int, int]]:
    """Return topic -> (number of messages, CRC over their times, sequences and payloads)."""
    digest: dict[str, tuple[int, int]] = {}
    for m in _messages(index):
        n, crc = digest.get(m.channel.topic, (0, 0))
        head = b"%d %d %d " % (m.sequence, m.log_time, m.publish_time)
        digest[m.channel.topic] = n + 1, zlib.crc32(m.data, zlib.crc32(head, crc))
    return digest


def _copy(index: SegmentIndex, copy: Path) -> dict[str, int]:
    """Write the messages of a checked file to a new one, verify it, return topic -> count."""
    part = copy.with_name(copy.name + PART)
    try:
        with part.open("xb") as file:
            _write(index, Writer(file, compression=CompressionType.NONE))
            file.flush()
            os.fdatasync(file.fileno())
        again = scan(part, check=True)
        expected, found = _digest(index), _digest(again)
        if again.cut or again.damaged or expected != found:
            part.unlink()
            raise RecordingError(
                f"{copy}: the copy reads back differently; check the disk, or name another target"
            )
        part.rename(copy)
    except FileExistsError:
        raise RecordingError(f"{part}: exists already; name another target") from None
    except OSError as error:
        part.unlink(missing_ok=True)
        raise RecordingError(f"{copy}: cannot be written ({error.strerror})") from None
    return {topic: n for topic, (n, _) in found.items()}


def _write(index: SegmentIndex, writer: Writer) -> None:
    writer.start(library="calm-edge recover")
    for metadata in index.metadata:
        writer.add_metadata(metadata.name, metadata.metadata)
    if index.cut and index.metadata_of(END_METADATA) is None:
        # it was being written when it ended: the copy holds all that there ever was
        writer.add_metadata(END_METADATA, {"recovered": index.path.name})
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    for m in _messages(index):
        old = m.channel
        if m.schema is not None and m.schema.id not in schemas:
            schemas[m.schema.id] = writer.register_schema(
                m.schema.name, m.schema.encoding, m.schema.data
            )
        if old.id not in channels:
            channels[old.id] = writer.register_channel(
                old.topic, old.message_encoding, schemas.get(old.schema_id, 0), old.metadata
            )
        writer.add_message(channels[old.id], m.log_time, m.data, m.publish_time, m.sequence)
    writer.finish()  # type: ignore[no-untyped-call]
