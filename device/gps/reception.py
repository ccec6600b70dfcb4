"""Fixes as they arrive from a receiver, and what is wrong with it while none do."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterable

from device.gps.fix import Fix

# a receiver sends once a second, or more often
SILENT_S = 5.0
MAX_WAITING = 1000


class Reception:
    """Queue of fixes between the thread that receives them and the one that takes them.

    expected, remedy: what should arrive, and what to do if other bytes do.
    """

    def __init__(self, name: str, expected: str, remedy: str) -> None:
        self._name, self._expected, self._remedy = name, expected, remedy
        self._fixes: deque[Fix] = deque(maxlen=MAX_WAITING)
        self.opened()

    def opened(self) -> None:
        """Wait anew for the first bytes."""
        self._bytes_s = self._valid_s = time.monotonic()
        self._heard = False

    def heard(self, valid: bool, fixes: Iterable[Fix]) -> None:
        """Note bytes that arrived, whether they had the expected form, and their fixes."""
        self._heard = True
        self._bytes_s = time.monotonic()
        if valid:
            self._valid_s = self._bytes_s
        self._fixes.extend(fixes)

    def take(self) -> list[Fix]:
        """Return the fixes since the last call."""
        found = []
        while self._fixes:
            found.append(self._fixes.popleft())
        return found

    @property
    def fault(self) -> str:
        """What is wrong with the receiver; empty while it sends."""
        now_s = time.monotonic()
        if now_s - self._bytes_s > SILENT_S:
            for_s = math.floor(now_s - self._bytes_s)
            return f"{self._name}: sends nothing for {for_s} s; check its power and its wires"
        if self._heard and now_s - self._valid_s > SILENT_S:
            return f"{self._name}: sends no {self._expected}; {self._remedy}"
        return ""
