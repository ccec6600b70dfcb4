"""Indexing files of other writers: compressed, without chunks, not MCAP."""

from __future__ import annotations

import resource
import struct
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType, Writer

from calm_edge.recording.scan import DamageError, plain_chunk, scan


def write(path: Path, **options: object) -> None:
    with path.open("wb") as file:
        writer = Writer(file, 2000, **options)  # type: ignore[arg-type]
        writer.start()
        channel = writer.register_channel("/a", "json", 0)
        for k in range(50):
            writer.add_message(channel, k, b"%d " % k * 100, k, k)
        writer.finish()


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_compression_can_be_read(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "a.mcap"
    write(path, compression=compression)
    index = scan(path)
    ((_, rows),) = index.topic_rows("/a")
    raw = path.read_bytes()
    for k in range(50):
        ref = index.chunks[rows.chunk[k]]
        data = plain_chunk(raw[ref.offset : ref.offset + ref.size])
        assert data[rows.offset[k] : rows.offset[k] + rows.size[k]] == b"%d " % k * 100
        assert (rows.log_time[k], rows.sequence[k], rows.publish_time[k]) == (k, k, k)
    assert len(index.chunks) > 1


def test_messages_outside_of_chunks_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path, use_chunking=False)
    index = scan(path)
    assert (index.n_messages, index.loose_messages) == (0, 50)


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
def test_a_chunk_larger_than_declared_counts_as_damaged(
    compression: CompressionType,
) -> None:
    zeros = bytes(64 << 20)
    packed = {
        CompressionType.ZSTD: lambda: zstandard.ZstdCompressor().compress(zeros),
        CompressionType.LZ4: lambda: lz4.frame.compress(zeros),
    }[compression]()
    name = compression.name.lower().encode()
    head = struct.pack("<QQQII", 0, 0, 1000, 0, len(name)) + name
    content = head + struct.pack("<Q", len(packed)) + packed
    assert len(content) < 1 << 20
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(DamageError, match="does not have the size in its header"):
        plain_chunk(content)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < 16 << 10
