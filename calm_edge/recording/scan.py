"""Index the messages of one MCAP file, finished or truncated (https://mcap.dev/spec).

Headers are read and payloads skipped; an unfinished file is checked chunk by chunk, since its last
bytes may be invalid. A chunk that is truncated or fails its CRC is not used.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema

from calm_edge.recording import RecordingError
from calm_edge.recording.schema import END_KEY, END_METADATA, IMAGE_TOPICS, SESSION_METADATA
from calm_edge.recording.time_base import EPOCH_KEY, integer

MAGIC = b"\x89MCAP0\r\n"
# calm-edge's chunks are about 1 MiB plus one message; larger ones are regarded as damaged
MAX_CHUNK_BYTES = 256 << 20
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
_FIRST_PRIVATE_OPCODE = 0x80

ReadAt = Callable[[int, int], bytes]


class DamageError(Exception):
    """A record or chunk is truncated or damaged."""


@dataclass(frozen=True, slots=True)
class ChunkRef:
    """A chunk record: offset and size of its content in the file, range of its log times in ns."""

    offset: int
    size: int
    start_ns: int
    end_ns: int


@dataclass(slots=True)
class Rows:
    """Messages of one channel as columns, in file order. offset: within the decompressed chunk."""

    chunk: array[int] = field(default_factory=lambda: array("q"))
    offset: array[int] = field(default_factory=lambda: array("q"))
    size: array[int] = field(default_factory=lambda: array("q"))
    sequence: array[int] = field(default_factory=lambda: array("q"))
    log_time: array[int] = field(default_factory=lambda: array("Q"))
    publish_time: array[int] = field(default_factory=lambda: array("Q"))

    def __len__(self) -> int:
        return len(self.chunk)


@dataclass(slots=True)
class SegmentIndex:
    """Index of one file: messages by channel id, and damage.

    cut: why reading ended early, empty for a complete file. cut_bytes: bytes not read after that.
    damaged: chunks that failed their check. data_ended: the end of the data section was reached,
    so a cut concerns only the summary after it and no message.
    loose_messages: number of messages outside of chunks (of other writers), which are not read.
    """

    path: Path
    chunks: list[ChunkRef] = field(default_factory=list)
    rows: dict[int, Rows] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    damaged: list[ChunkRef] = field(default_factory=list)
    cut: str = ""
    cut_bytes: int = 0
    data_ended: bool = False
    loose_messages: int = 0

    @property
    def n_messages(self) -> int:
        return sum(len(rows) for rows in self.rows.values())

    def topic_rows(self, topic: str) -> list[tuple[Channel, Rows]]:
        """Return the channels of a topic that hold messages."""
        return [
            (c, self.rows[i])
            for i, c in self.channels.items()
            if c.topic == topic and i in self.rows
        ]

    def metadata_of(self, name: str) -> dict[str, str] | None:
        """The first metadata of a name, or None."""
        return next((m.metadata for m in self.metadata if m.name == name), None)

    @property
    def epoch_ns(self) -> int | None:
        """`TimeBase.epoch_ns` of the file; None of an earlier version, whose log_time is t_ns."""
        return integer(self.metadata_of(SESSION_METADATA) or {}, EPOCH_KEY)

    def t_ns(self, rows: Rows) -> list[int]:
        """Times t_ns of messages, as of frames."""
        epoch_ns = self.epoch_ns
        if epoch_ns is None:
            return rows.log_time.tolist()
        return [published - epoch_ns for published in rows.publish_time]

    @property
    def newest_ns(self) -> int | None:
        """Time t_ns of the newest image, else of the newest message; None without any.

        Images are preferred: in a replay the other messages are stamped by another clock.
        """
        images = [rows for topic in IMAGE_TOPICS.values() for _, rows in self.topic_rows(topic)]
        return max((max(self.t_ns(rows)) for rows in images or self.rows.values()), default=None)

    def missing_end(self) -> list[str]:
        """One line if this last segment of a folder is complete and does not end the recording.

        Nothing is known of recordings of versions that did not mark their end.
        """
        marks = END_KEY in (self.metadata_of(SESSION_METADATA) or {})
        if self.cut or not marks or self.metadata_of(END_METADATA) is not None:
            return []
        return [
            f"{self.path}: the end of the recording is not in it, and no segment follows; copy the "
            "folder again, unless the disk was full or the power failed"
        ]

    def losses(self) -> list[str]:
        """Describe each loss in one line: file, cause, time of the loss, messages recovered."""
        lines = []
        recovered = f"recovered: {self.n_messages} messages"
        if self.cut and not self.data_ended:
            end = self.newest_ns
            since = "all of it" if end is None else f"everything after t = {end / 1e9:.3f} s"
            lines.append(
                f"{self.path}: {self.cut}; lost: {since} ({self.cut_bytes} bytes unreadable); "
                f"{recovered}"
            )
        elif self.cut:
            lines.append(
                f"{self.path}: {self.cut}, after the last message; "
                f"recovered: all {self.n_messages} messages"
            )
        if self.damaged:
            lines.append(
                f"{self.path}: {len(self.damaged)} damaged chunks left out "
                f"({sum(c.size for c in self.damaged)} bytes); {recovered}"
            )
        if self.loose_messages:
            lines.append(f"{self.path}: {self.loose_messages} messages outside of chunks left out")
        return lines


def _walk(read: ReadAt, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Iterate over (opcode, content offset, content length); raises DamageError at a bad record."""
    at = start
    while at < end:
        head = read(at, _RECORD.size)
        if len(head) < _RECORD.size:
            raise DamageError("cut off within a record's header")
        opcode, length = _RECORD.unpack(head)
        if opcode == 0 or Opcode.DATA_END < opcode < _FIRST_PRIVATE_OPCODE:
            raise DamageError("a record of unknown type")
        if at + _RECORD.size + length > end:
            raise DamageError("cut off within a record")
        yield opcode, at + _RECORD.size, length
        at += _RECORD.size + length


def plain_chunk(content: bytes) -> bytes:
    """Decompress and check a chunk record's content, return its records; raises DamageError."""
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(content)))
        if chunk.uncompressed_size > MAX_CHUNK_BYTES:
            raise DamageError("the chunk's size in its header is out of range")
        data = _decompressed(chunk.compression, chunk.data, chunk.uncompressed_size)
    except DamageError:
        raise
    except Exception as error:
        # decompressors raise exceptions of various types on damaged input
        raise DamageError(str(error)) from None
    if len(data) != chunk.uncompressed_size:
        raise DamageError("the chunk's content does not have the size in its header")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamageError("the chunk has a wrong CRC")
    return data


def _decompressed(compression: str, data: bytes, size: int) -> bytes:
    """Decompress at most `size` + 1 bytes, so that damaged data cannot fill the memory.

    size: the decompressed size declared in the chunk.
    """
    if compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            return bytes(reader.read(size + 1))
    if compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, size + 1))
    if compression:
        raise DamageError(f"unknown compression {compression!r}")
    return data


def _slice(data: bytes, at: int, n: int) -> bytes:
    return data[at : at + n]


def _index_chunk(index: SegmentIndex, read: ReadAt, offset: int, length: int, check: bool) -> None:
    """Add a chunk's messages, channels and schemas to the index; raises DamageError."""
    if length > MAX_CHUNK_BYTES or length < _CHUNK.size + 8:
        raise DamageError("the chunk's size in its header is out of range")
    head = read(offset, _CHUNK.size)
    start_ns, end_ns, _, _, name_length = _CHUNK.unpack(head)
    base = 0
    records: ReadAt
    if check or name_length:
        data = plain_chunk(read(offset, length))
        records, end = partial(_slice, data), len(data)
    else:
        # the chunk is uncompressed: read only the records' headers, from the file itself; payloads
        # are read and checked when needed
        base = offset + _CHUNK.size + 8
        records, end = read, offset + length
    number = len(index.chunks)
    rows: list[tuple[int, int, int, int, int, int]] = []
    channels, schemas = [], []
    for opcode, at, size in _walk(records, base, end):
        if opcode == Opcode.MESSAGE:
            if size < _MESSAGE.size:
                raise DamageError("a message record is shorter than its header")
            channel, sequence, log, publish = _MESSAGE.unpack(records(at, _MESSAGE.size))
            payload = at - base + _MESSAGE.size
            rows.append((channel, payload, size - _MESSAGE.size, sequence, log, publish))
        elif opcode == Opcode.CHANNEL:
            channels.append(_parse(Channel, records(at, size)))
        elif opcode == Opcode.SCHEMA:
            schemas.append(_parse(Schema, records(at, size)))
    index.chunks.append(ChunkRef(offset, length, start_ns, end_ns))
    index.channels.update({c.id: c for c in channels})
    index.schemas.update({s.id: s for s in schemas})
    for channel, at, size, sequence, log, publish in rows:
        row = index.rows.setdefault(channel, Rows())
        row.chunk.append(number)
        row.offset.append(at)
        row.size.append(size)
        row.sequence.append(sequence)
        row.log_time.append(log)
        row.publish_time.append(publish)


def _parse(kind: Any, content: bytes) -> Any:
    try:
        return kind.read(ReadDataStream(io.BytesIO(content)))
    except (McapError, struct.error, UnicodeDecodeError) as error:
        raise DamageError(str(error)) from None


def _fill(index: SegmentIndex, read: ReadAt, size: int, check: bool) -> None:
    intact = len(MAGIC)
    try:
        for opcode, at, length in _walk(read, intact, size):
            if opcode == Opcode.CHUNK:
                try:
                    _index_chunk(index, read, at, length, check)
                except DamageError:
                    index.damaged.append(ChunkRef(at, length, 0, 0))
            elif opcode == Opcode.METADATA:
                index.metadata.append(_parse(Metadata, read(at, length)))
            elif opcode == Opcode.CHANNEL:
                # from the summary, which repeats those of the chunks: one may have been damaged
                channel = _parse(Channel, read(at, length))
                index.channels.setdefault(channel.id, channel)
            elif opcode == Opcode.SCHEMA:
                schema = _parse(Schema, read(at, length))
                index.schemas.setdefault(schema.id, schema)
            elif opcode == Opcode.MESSAGE:
                index.loose_messages += 1
            elif opcode == Opcode.DATA_END:
                index.data_ended = True
            elif opcode == Opcode.FOOTER:
                if read(at + length, len(MAGIC)) != MAGIC:
                    index.cut = "cut off after its last record"
                return
            intact = at + length
        index.cut = "never finished"
    except DamageError as error:
        index.cut = str(error)
        index.cut_bytes = size - intact


def scan(path: Path, check: bool | None = None) -> SegmentIndex:
    """Index one file; raises RecordingError if it cannot be read, is empty or is not MCAP.

    check: verify every chunk now; None does so for unfinished files only.
    """
    try:
        with path.open("rb", buffering=0) as file:
            size = os.fstat(file.fileno()).st_size

            def read(offset: int, n: int) -> bytes:
                return os.pread(file.fileno(), n, offset)

            if size == 0:
                raise RecordingError(f"{path}: is empty; nothing can be recovered from it")
            if read(0, len(MAGIC)) != MAGIC:
                raise RecordingError(f"{path}: is not an MCAP recording; name another file")
            if check is None:
                check = read(size - len(MAGIC), len(MAGIC)) != MAGIC
            index = SegmentIndex(path)
            _fill(index, read, size, check)
            return index
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read ({error.strerror})") from None
