"""Lines for the user that may come often, at most one a minute."""

from __future__ import annotations

import time
from collections.abc import Callable

PERIOD_S = 60.0


class Seldom:
    """Passes a line on to `say` if none was in the last PERIOD_S; the next one counts the rest.

    now_s: monotonic time in seconds.
    """

    def __init__(
        self, say: Callable[[str], None], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._say, self._now_s = say, now_s
        self._said_s: float | None = None
        self._unsaid = 0

    def __call__(self, line: str) -> None:
        """Say the line, or count it."""
        now_s = self._now_s()
        if self._said_s is not None and now_s - self._said_s < PERIOD_S:
            self._unsaid += 1
            return
        more = f" (and {self._unsaid} more since the last such line)" if self._unsaid else ""
        self._said_s, self._unsaid = now_s, 0
        self._say(line + more)
