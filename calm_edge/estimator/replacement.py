"""Rectify and place all sub-maps again during a drive, a few per window."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import partial

from calm_edge.estimator.atlas import Atlas
from calm_edge.estimator.rectifier import Rectifier
from calm_edge.estimator.scale import ScaleError
from calm_edge.types import Submap

log = logging.getLogger(__name__)

# All sub-maps are rectified and placed again, if the calibration has changed, once their number has
# grown by this factor since the last time: calibration changes little late in a drive.
REPLACE_GROWTH = 1.1


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


class Replacements:
    """The replacements of a drive, one at a time.

    stale: the calibration has changed since the last one began.
    """

    def __init__(self, live: Atlas, rectifier: Rectifier) -> None:
        self._live, self._rectifier = live, rectifier
        self._current: Replacement | None = None
        self._n_replaced = 0
        self.stale = False

    @property
    def sources(self) -> tuple[Submap, ...]:
        """All sub-maps with their newest raw poses, also those not yet placed again."""
        return self._current.sources if self._current else self._live.submaps

    @property
    def due(self) -> bool:
        """Whether all sub-maps are to be placed again because of a new calibration."""
        grown = len(self._live) >= REPLACE_GROWTH * self._n_replaced
        return self.stale and grown and self._current is None

    def begin(self, submaps: Sequence[Submap]) -> None:
        """Begin to rectify the sub-maps from their raw poses and to place them again."""
        self.stale, self._n_replaced = False, len(submaps)
        calibration = self._rectifier.calibration
        rectify = partial(self._rectifier.rectify, calibration=calibration)
        self._current = Replacement(self._live, submaps, rectify)

    def advance(self, most: int | None = None) -> bool:
        """Place up to `most` further sub-maps again (None: all); True if all poses changed."""
        if self._current is None or not self._current.advance(most):
            return False
        self._current = None
        return True
