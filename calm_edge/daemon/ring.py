"""Frames from capture to tracker: slots of shared memory. Neither side ever waits for the other."""

from __future__ import annotations

from multiprocessing.shared_memory import SharedMemory


class FrameRing:
    """The writer's side: owner of the memory and of the list of free slots."""

    def __init__(self, n_slots: int, slot_bytes: int) -> None:
        self.slot_bytes = slot_bytes
        self._memory = SharedMemory(create=True, size=n_slots * slot_bytes)
        self._free = list(range(n_slots))
        self.dropped = 0

    @property
    def name(self) -> str:
        """What the reader opens."""
        return self._memory.name

    def put(self, data: bytes) -> int | None:
        """The slot that now holds `data`; None and counted when too large or all are taken."""
        if not self._free or len(data) > self.slot_bytes:
            self.dropped += 1
            return None
        slot = self._free.pop(0)
        start = slot * self.slot_bytes
        self._buffer()[start : start + len(data)] = data
        return slot

    def release(self, slot: int) -> None:
        """The reader has copied the slot out."""
        self._free.append(slot)

    def close(self) -> None:
        """Gives the memory back."""
        self._memory.close()
        self._memory.unlink()

    def _buffer(self) -> memoryview:
        buffer = self._memory.buf
        assert buffer is not None
        return buffer


class RingReader:
    """The reader's side."""

    def __init__(self, name: str, slot_bytes: int) -> None:
        self._memory = SharedMemory(name=name)
        self._slot_bytes = slot_bytes

    def read(self, slot: int, size: int) -> bytes:
        """A copy of the first `size` bytes of a slot."""
        buffer = self._memory.buf
        assert buffer is not None
        start = slot * self._slot_bytes
        return bytes(buffer[start : start + size])

    def close(self) -> None:
        """Lets go of the memory, which its writer gives back."""
        self._memory.close()
