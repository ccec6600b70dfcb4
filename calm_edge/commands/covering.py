"""Find out which of two cameras is which by covering a lens with the hand."""

from __future__ import annotations

from collections.abc import Callable

from calm_edge.types import CalmEdgeError

# shares of the brightness before: the covered camera falls below, the other one stays above
COVERED, STAYS = 0.5, 0.75
# polls in a row: a hand passes both
POLLS = 3


class CoveringError(CalmEdgeError):
    """No lens was covered."""


def covered(brightness: Callable[[], tuple[float, float] | None], polls: int) -> int:
    """Index of the camera that becomes dark while the other does not.

    brightness: mean grey of both cameras now; None: a camera gave no picture. polls: how often to
    ask. Raises CoveringError.
    """
    before: tuple[float, float] | None = None
    dark, times = -1, 0
    for _ in range(polls):
        now = brightness()
        if now is None:
            continue
        if before is None:
            before = now
            continue
        shares = [b / max(a, 1.0) for a, b in zip(before, now, strict=True)]
        low = min(range(2), key=shares.__getitem__)
        if shares[low] < COVERED and shares[1 - low] > STAYS:
            times = times + 1 if low == dark else 1
            dark = low
            if times == POLLS:
                return dark
        else:
            dark, times = -1, 0
    raise CoveringError(
        "no lens became dark while the other stayed bright: cover one closely, in enough light"
    )
