"""Windows held with their pictures, to be solved again from them once the kit is known.

Before the rig is known the matching between the cameras is not guided, and the solution starts from
a guessed focal. What is wrong in the matches of such a window stays wrong when it is solved again
from its landmarks; so does a window that was refused.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from calm_edge.kit import layout
from calm_edge.types import Float, Prediction, SubmapWindow

# Number of windows held, with about 4 MB of JPEG each. The pictures of others are in the recording,
# from which `calm-edge map` solves them again.
HELD_WINDOWS = 12


def unsettled(prediction: Prediction) -> bool:
    """Whether a window was matched before the rig was known, or fits too badly to teach the kit."""
    sigma = prediction.kit_sigma
    return sigma is not None and (prediction.kit is None or bool(sigma[0] >= layout.RIG_KNOWN_RAD))


def worth_solving(before: Float, now: Float, *, final: bool = False) -> bool:
    """Whether the kit is so much better known that a window is to be solved again from pictures.

    before, now: (2,) `kit_sigma` of the window's last attempt, and now. A sigma that did not count
    as known must have halved. final: no more is to be learned; else the rig must be known now.
    """
    better = np.any((now < before / 2) & (before > layout.KIT_KNOWN))
    return bool(better and (final or now[0] < layout.RIG_KNOWN_RAD))


class HeldWindows:
    """The newest `limit` windows to be solved again, with the kit_sigma of their last attempt."""

    def __init__(self, limit: int = HELD_WINDOWS) -> None:
        self._limit = limit
        self._held: dict[int, tuple[SubmapWindow, Float]] = {}

    def hold(self, window: SubmapWindow, sigma: Float) -> None:
        """Hold a window, or its newest attempt; the oldest one is dropped above the limit."""
        self._held[window.submap_id] = window, sigma
        while len(self._held) > self._limit:
            del self._held[next(iter(self._held))]

    def forget_attempts(self) -> None:
        """Make all held windows worth solving again, once the rig is known."""
        never = np.full(2, np.inf)
        self._held = {i: (window, never) for i, (window, _) in self._held.items()}

    def drop(self, submap_id: int) -> None:
        """Hold a window no longer, if it is held."""
        self._held.pop(submap_id, None)

    def next(self, sigma_now: Callable[[int], Float], *, final: bool) -> SubmapWindow | None:
        """The oldest window that is worth solving again. sigma_now: its `kit_sigma` by its id."""
        return next(
            (
                window
                for submap_id, (window, before) in self._held.items()
                if worth_solving(before, sigma_now(submap_id), final=final)
            ),
            None,
        )
