"""Shared memory through which the capture process passes frames to the tracker, without locks."""

from __future__ import annotations

from multiprocessing.shared_memory import SharedMemory


class FrameRing:
    """Writing side: owner of the shared memory and of the list of free slots."""

    def __init__(self, n_slots: int, slot_bytes: int) -> None:
        self.slot_bytes = slot_bytes
        self._memory = SharedMemory(create=True, size=n_slots * slot_bytes)
        self._free = list(range(n_slots))

    @property
    def name(self) -> str:
        """Name of the shared memory."""
        return self._memory.name

    def put(self, data: bytes) -> int | None:
        """Copy `data` into a free slot; None if it is too large or no slot is free."""
        if not self._free or len(data) > self.slot_bytes:
            return None
        slot = self._free.pop(0)
        start = slot * self.slot_bytes
        self._buffer()[start : start + len(data)] = data
        return slot

    def release(self, slot: int) -> None:
        """Mark a slot as free, once the reader is done with it."""
        self._free.append(slot)

    def close(self) -> None:
        """Remove the shared memory."""
        self._memory.close()
        self._memory.unlink()

    def _buffer(self) -> memoryview:
        buffer = self._memory.buf
        assert buffer is not None
        return buffer


class RingReader:
    """Reading side: maps the shared memory of a FrameRing."""

    def __init__(self, name: str, slot_bytes: int) -> None:
        self._memory = SharedMemory(name=name)
        self._slot_bytes = slot_bytes

    def read(self, slot: int, size: int) -> bytes:
        """Return a copy of the first `size` bytes of a slot."""
        buffer = self._memory.buf
        assert buffer is not None
        start = slot * self._slot_bytes
        return bytes(buffer[start : start + size])

    def close(self) -> None:
        """Unmap the memory; the writer removes it."""
        self._memory.close()
