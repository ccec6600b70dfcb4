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

    The live poses change all at once, when the second atlas has caught up with the live one.
    submaps: all of the live atlas in order, with the raw poses to use, and any that are to be
    inserted. rectify: rectifies one from its raw poses; may raise ScaleError. Sub-maps added to the
    live atlas later are not rectified again.
    """

    def __init__(
        self, live: Atlas, submaps: Sequence[Submap], rectify: Callable[[Submap], Submap]
    ) -> None:
        self._live, self._submaps, self._rectify = live, tuple(submaps), rectify
        self._n_live = len(live)
        self._next, self._done = live.empty(), 0

    @property
    def sources(self) -> tuple[Submap, ...]:
        """All sub-maps of the drive so far, with the raw poses used for the second atlas."""
        return self._submaps + self._live.submaps[self._n_live :]

    def advance(self, most: int | None = None) -> bool:
        """Place up to `most` further sub-maps (None: all); True if the live atlas was replaced."""
        sources = self.sources
        end = len(sources) if most is None else min(self._done + most, len(sources))
        for k in range(self._done, end):
            submap = sources[k] if k >= len(self._submaps) else self._rectified(sources[k])
            if submap is not None:
                self._next.add(submap)
        self._done = end
        if end < len(sources):
            return False
        self._live.become(self._next)
        return True

    def _rectified(self, source: Submap) -> Submap | None:
        """A sub-map rectified again; if that fails, as placed in the live atlas, or None."""
        try:
            return self._rectify(source)
        except ScaleError as error:
            log.warning("sub-map %d keeps its earlier solution: %s", source.id, error)
            return next((s for s in self._live.submaps if s.id == source.id), None)
