"""Walking files of other writers: compression, no chunks, no MCAP."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from calm_edge.recording.scan import plain_chunk, scan


def write(path: Path, **options: object) -> None:
    with path.open("wb") as file:
        writer = Writer(file, 2000, **options)  # type: ignore[arg-type]
        writer.start()
        channel = writer.register_channel("/a", "json", 0)
        for k in range(50):
            writer.add_message(channel, k, b"%d " % k * 100, k, k)
        writer.finish()


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_compression_reads_back(tmp_path: Path, compression: CompressionType) -> None:
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


def test_messages_outside_of_chunks_are_counted_not_hidden(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write(path, use_chunking=False)
    index = scan(path)
    assert (index.n_messages, index.loose_messages) == (0, 50)
