"""Close loops, section IV-D: an earlier image of the same place joins the batch of a window."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calm_edge.estimator.atlas import Atlas
from calm_edge.geometry import se3
from calm_edge.loops.finder import LoopCandidate, LoopFinder
from calm_edge.loops.same_place import KnownKit
from calm_edge.types import Bytes, LoopClosure, Prediction, Submap, SubmapWindow

log = logging.getLogger(__name__)


class LoopClosing:
    """Loop views of windows, and the closures measured from them.

    finder: finds the earlier image; None if loops are disabled. spacing: of the cameras, in the
    units of the sub-maps.
    """

    def __init__(self, finder: LoopFinder | None, atlas: Atlas, spacing: float) -> None:
        self._finder, self._atlas, self._spacing = finder, atlas, spacing

    def allowed(self, window: SubmapWindow) -> SubmapWindow:
        """The window, without its recorded loop keyframe if loops are disabled."""
        return replace(window, loop_keyframe=None) if self._finder is None else window

    def with_loop(
        self, window: SubmapWindow, images: list[Bytes]
    ) -> tuple[SubmapWindow, list[Bytes], LoopCandidate | None]:
        """Append an earlier image of the same place to the batch, if one is found (IV-D).

        A window from a recording that has a loop keyframe keeps it.
        """
        if self._finder is None:
            return window, images, None
        candidate = self._finder.find(window, images, self._known_kit())
        if candidate is None or window.loop_keyframe is not None:
            return window, images, None
        joined = replace(window, loop_keyframe=candidate.keyframe)
        return joined, [*images, candidate.keyframe.frame.bgr()], candidate

    def closure(
        self,
        window: SubmapWindow,
        submap: Submap,
        prediction: Prediction,
        candidate: LoopCandidate | None,
        sources: Sequence[Submap],
    ) -> LoopClosure | None:
        """Loop closure with the pose that the backbone computed for the loop keyframe.

        None if there is no such keyframe or pose, if no sub-map of `sources` has the keyframe, or
        if the pose disagrees with the approximate one of the candidate, from matches of the two
        images.
        """
        match = window.loop_keyframe
        if match is None or not prediction.loop_found:
            return None
        if not any(match.id in source.primary_ids for source in sources):
            return None
        T_s_match = submap.T_s_c[-1]
        apart = np.linalg.norm(submap.T_s_c[: submap.n_primary, :3, 3] - T_s_match[:3, 3], axis=1)
        query = candidate.query_view if candidate is not None else int(apart.argmin())
        T_match_query = se3.inverse(T_s_match) @ submap.T_s_c[query]
        if candidate is not None and not candidate.agrees(
            se3.inverse(T_match_query), self._spacing
        ):
            log.info("sub-map %d: loop closure with keyframe %d rejected", submap.id, match.id)
            return None
        return LoopClosure(submap.primary_ids[query], match.id, T_match_query)

    def remember(self, window: SubmapWindow) -> None:
        """Make the keyframes of a window, which now have poses, places of the search."""
        if self._finder is not None:
            self._finder.remember(window)

    def restore(self, window: SubmapWindow) -> None:
        """Make the keyframes of a window solved earlier places of the search."""
        if self._finder is not None:
            # without a kit `find` only describes them
            self._finder.find(
                window, [keyframe.frame.bgr() for keyframe in window.keyframes()], None
            )
            self._finder.remember(window)

    def _known_kit(self) -> KnownKit | None:
        if not len(self._atlas):
            return None
        newest = self._atlas.submaps[-1]
        cameras = newest.cameras[0], newest.cameras[newest.n_primary]
        return KnownKit(cameras, self._atlas.T_p_a)
