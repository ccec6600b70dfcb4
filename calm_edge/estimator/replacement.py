"""Rectify and place all sub-maps again during a drive, a few per window."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from calm_edge.estimator.atlas import Atlas
from calm_edge.estimator.scale import ScaleError
from calm_edge.types import Submap

log = logging.getLogger(__name__)


class Replacement:
    """Build a second atlas from sub-maps rectified again, and replace the live one by it.

    The live poses change all at once, when the second atlas has as many sub-maps as the live one.
    submaps: all of the live atlas, with the raw poses to use. rectify: rectifies one from its raw
    poses; may raise ScaleError. Sub-maps added to the live atlas later are not rectified again.
    """

    def __init__(
        self, live: Atlas, submaps: Sequence[Submap], rectify: Callable[[Submap], Submap]
    ) -> None:
        self._live, self._submaps, self._rectify = live, tuple(submaps), rectify
        self._next = live.empty()

    @property
    def sources(self) -> tuple[Submap, ...]:
        """All sub-maps of the live atlas, with the raw poses used for the second one."""
        return self._submaps + self._live.submaps[len(self._submaps) :]

    def advance(self, most: int | None = None) -> bool:
        """Place up to `most` further sub-maps (None: all); True if the live atlas was replaced."""
        placed = self._live.submaps
        done = len(self._next)
        end = len(placed) if most is None else min(done + most, len(placed))
        for k in range(done, end):
            self._next.add(self._rectified(k, placed[k]))
        if end < len(placed):
            return False
        self._live.become(self._next)
        return True

    def _rectified(self, k: int, placed: Submap) -> Submap:
        """Sub-map k rectified again; as placed if that fails or if it was added later."""
        if k >= len(self._submaps):
            return placed
        try:
            return self._rectify(self._submaps[k])
        except ScaleError as error:
            log.warning("sub-map %d keeps its earlier solution: %s", placed.id, error)
            return placed
