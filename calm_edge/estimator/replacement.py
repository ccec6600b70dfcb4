"""All sub-maps placed anew while a drive goes on: some with every window, so that none waits."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from calm_edge.estimator.atlas import Atlas
from calm_edge.estimator.scale import ScaleError
from calm_edge.types import Submap

log = logging.getLogger(__name__)


class Replacement:
    """Rectifies sub-maps again and places them in an atlas beside the live one.

    Once it has caught up with the live atlas it takes that one's place, all at once: until then
    every pose stays. submaps: those to be rectified again, by `rectify`, which may raise
    ScaleError; what comes later goes over as it was rectified when it came.
    """

    def __init__(
        self, live: Atlas, submaps: Sequence[Submap], rectify: Callable[[Submap], Submap]
    ) -> None:
        self._live, self._submaps, self._rectify = live, tuple(submaps), rectify
        self._anew = live.empty()

    @property
    def sources(self) -> tuple[Submap, ...]:
        """Every sub-map of the live atlas, with the raw poses that the new one will have."""
        return self._submaps + self._live.submaps[len(self._submaps) :]

    def advance(self, most: int | None = None) -> bool:
        """At most so many sub-maps more, None for all; whether the live atlas is the new one."""
        placed = self._live.submaps
        done = len(self._anew)
        end = len(placed) if most is None else min(done + most, len(placed))
        for k in range(done, end):
            self._anew.add(self._again(k, placed[k]))
        if end < len(placed):
            return False
        self._live.become(self._anew)
        return True

    def _again(self, k: int, placed: Submap) -> Submap:
        """As it is now known; as it was where that has no scale, or where it came later."""
        if k >= len(self._submaps):
            return placed
        try:
            return self._rectify(self._submaps[k])
        except ScaleError as error:
            log.warning("sub-map %d keeps its earlier solution: %s", placed.id, error)
            return placed
