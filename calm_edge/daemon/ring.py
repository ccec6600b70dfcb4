"""Shared memory through which the capture process passes frames to the tracker, without locks."""

from __future__ import annotations

from multiprocessing.shared_memory import SharedMemory


class FrameRing:
    """Writing side: owner of the shared memory and of the list of free slots.

    Data larger than a slot takes several neighbouring ones.
    """

    def __init__(self, n_slots: int, slot_bytes: int) -> None:
        self.slot_bytes = slot_bytes
        self._memory = SharedMemory(create=True, size=n_slots * slot_bytes)
        self._free = [True] * n_slots
        self._taken: dict[int, int] = {}

    @property
    def name(self) -> str:
        """Name of the shared memory."""
        return self._memory.name

    def put(self, data: bytes) -> int | None:
        """Copy `data` into free slots and return the first; None if there is no room."""
        n = max(1, -(-len(data) // self.slot_bytes))
        slots = range(len(self._free) - n + 1)
        slot = next((i for i in slots if all(self._free[i : i + n])), None)
        if slot is None:
            return None
        self._free[slot : slot + n] = [False] * n
        self._taken[slot] = n
        start = slot * self.slot_bytes
        self._buffer()[start : start + len(data)] = data
        return slot

    def release(self, slot: int) -> None:
        """Mark the slots of data as free, once the reader is done with it. slot: the first."""
        n = self._taken.pop(slot)
        self._free[slot : slot + n] = [True] * n

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
        """Return a copy of `size` bytes from a slot on."""
        buffer = self._memory.buf
        assert buffer is not None
        start = slot * self._slot_bytes
        return bytes(buffer[start : start + size])

    def close(self) -> None:
        """Unmap the memory; the writer removes it."""
        self._memory.close()
