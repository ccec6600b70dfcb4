from collections.abc import Iterator

import pytest

from calm_edge.daemon.ring import FrameRing, RingReader


@pytest.fixture
def ring() -> Iterator[FrameRing]:
    ring = FrameRing(6, 100)
    yield ring
    ring.close()


def test_data_of_any_size_up_to_the_whole_ring_is_read_back(ring: FrameRing) -> None:
    reader = RingReader(ring.name, ring.slot_bytes)
    for size in (0, 1, 100, 101, 250, 600):
        data = bytes(k % 251 for k in range(size))
        slot = ring.put(data)
        assert slot is not None and reader.read(slot, size) == data
        ring.release(slot)
    assert ring.put(bytes(601)) is None
    reader.close()


def test_large_and_small_data_do_not_overlap(ring: FrameRing) -> None:
    reader = RingReader(ring.name, ring.slot_bytes)
    first, large, last = ring.put(b"a" * 90), ring.put(b"b" * 310), ring.put(b"c" * 90)
    assert first is not None and large is not None and last is not None
    assert ring.put(b"d") is None
    ring.release(first)
    assert ring.put(b"e" * 150) is None
    again = ring.put(b"e" * 100)
    assert again is not None
    found = [reader.read(slot, n) for slot, n in [(again, 100), (large, 310), (last, 90)]]
    assert found == [b"e" * 100, b"b" * 310, b"c" * 90]
    reader.close()
