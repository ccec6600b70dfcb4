"""Check the stamps of a camera against the arrival of its frames on the host."""

from __future__ import annotations

from device.clock import NS_PER_S

# A stamp older than this, or further in the future, is of another clock than the host's.
OLDEST_NS = NS_PER_S
FURTHEST_NS = NS_PER_S // 2
# After a stall of the host a few frames arrive late with stamps that are right.
STALLED_FRAMES = 8


class ArrivalCheck:
    """Whether the stamps of one camera are on the host's clock.

    reason: how far off they were when they were found to be on another clock; empty before.
    """

    def __init__(self) -> None:
        self.reason = ""
        self._verified = False
        self._wrong_in_a_row = 0

    def usable(self, t_ns: int, now_ns: int) -> bool:
        """Whether to use a stamp; False if the time of arrival is to be used. now_ns: arrival."""
        late_ns = now_ns - t_ns
        if -FURTHEST_NS <= late_ns <= OLDEST_NS:
            self._verified, self._wrong_in_a_row = True, 0
            return True
        self._wrong_in_a_row += 1
        stalled = self._verified and late_ns > 0 and self._wrong_in_a_row <= STALLED_FRAMES
        if not stalled and not self.reason:
            seconds = abs(late_ns) / NS_PER_S
            self.reason = f"{seconds:.1f} s {'old' if late_ns > 0 else 'in the future'}"
        return stalled
