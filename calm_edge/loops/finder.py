"""Find loop closure candidates: retrieval by descriptor, verification by geometry (paper IV-D).

The backbone measures T_loop, as in the paper; the finder only chooses the earlier image that is
appended to its batch. Cost and memory are bounded: retrieval by `max_places`, verification by
`top_k`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np

from calm_edge.config import LoopConfig
from calm_edge.geometry import se3, sift
from calm_edge.geometry.camera import Camera
from calm_edge.loops.descriptor import GradientLayout, PlaceDescriptor
from calm_edge.loops.same_place import KnownKit, SamePlace, same_place
from calm_edge.types import Bytes, Float, Float32, Keyframe, SubmapWindow

MAX_FEATURES = 800
# All in keyframes. EVERY: step between queries, and between stored places. NEIGHBOUR: largest
# distance of neighbouring places. CLOSURE_GAP: smallest distance of two loop closures.
# SUPPRESSION: smallest distance of two candidates (non-maximum suppression).
EVERY = 2
NEIGHBOUR = 3
CLOSURE_GAP = 15
SUPPRESSION = 10
MAX_PICTURE_BYTES = 96 << 20
# images described in parallel
DESCRIBERS = 2
# Tolerance between the candidate's approximate pose and the backbone's: share of the distance
# plus a distance in spacings, and an angle.
AGREE_DISTANCE_SHARE, AGREE_DISTANCE, AGREE_RAD = 0.5, 3.0, np.radians(8.0)


@dataclass(frozen=True, slots=True)
class LoopCandidate:
    """An earlier primary keyframe that shows the same place as a view of the window.

    query_view: batch index of the view. T_query_match: (4, 4) match->query, i.e. from `keyframe`
    to the view, approximate, in camera spacings.
    """

    query_view: int
    keyframe: Keyframe
    T_query_match: Float

    def agrees(self, T_query_match: Float, spacing: float) -> bool:
        """Whether a measured pose (4, 4) agrees with the approximate one.

        spacing: camera spacing in the units of the measured pose.
        """
        own = np.array(self.T_query_match)
        own[:3, 3] *= spacing
        off = se3.inverse(own) @ T_query_match
        allowed = AGREE_DISTANCE * spacing + AGREE_DISTANCE_SHARE * np.linalg.norm(own[:3, 3])
        turned = np.linalg.norm(se3.so3_log(off[:3, :3]))
        return bool(np.linalg.norm(off[:3, 3]) < allowed and turned < AGREE_RAD)


class LoopFinder(Protocol):
    """Interface: find an earlier view of the same place for a window, among those remembered."""

    def find(
        self, window: SubmapWindow, images: Sequence[Bytes], kit: KnownKit | None
    ) -> LoopCandidate | None:
        """Find at most one candidate. images: (H, W, 3) uint8 BGR, in batch order."""
        ...

    def remember(self, window: SubmapWindow) -> None:
        """Add the keyframes of a window, which now have poses, to the places."""
        ...


class PlaceMemory:
    """The places of a drive so far: pairs of primary keyframes as JPEG, with descriptors.

    The two of a pair are EVERY to NEIGHBOUR keyframes apart. Pairs, because a loop at one place
    must be confirmed at a neighbouring one. At the limit of number or bytes every second pair is
    dropped, and new pairs are taken half as often.
    """

    def __init__(self, max_places: int, max_bytes: int = MAX_PICTURE_BYTES) -> None:
        self._max_places = max(2, max_places)
        self._max_bytes = max_bytes
        self._pairs: list[list[tuple[Keyframe, Float32]]] = []
        self.every = 2 * EVERY

    def __len__(self) -> int:
        return sum(len(pair) for pair in self._pairs)

    def add(self, keyframe: Keyframe, vector: Float32) -> None:
        """Add a keyframe as JPEG, with its descriptor, if it is far enough from the last one."""
        newest = self._pairs[-1] if self._pairs else []
        begins = not newest or keyframe.id >= newest[0][0].id + self.every
        joins = len(newest) == 1 and EVERY <= keyframe.id - newest[0][0].id <= NEIGHBOUR
        if not (begins or joins):
            return
        if begins:
            newest = []
            self._pairs.append(newest)
        newest.append((replace(keyframe, frame=keyframe.frame.encoded()), vector))
        while len(self._pairs) > 1 and (
            len(self) > self._max_places or self.n_bytes > self._max_bytes
        ):
            self._pairs = self._pairs[::2]
            self.every *= 2

    @property
    def n_bytes(self) -> int:
        """Size of all images [bytes]."""
        return sum(len(keyframe.frame.image) for pair in self._pairs for keyframe, _ in pair)

    def neighbours(self, place: Keyframe) -> list[Keyframe]:
        """Other places at most NEIGHBOUR keyframes from a given one."""
        every = [keyframe for pair in self._pairs for keyframe, _ in pair]
        return [other for other in every if 0 < abs(other.id - place.id) <= NEIGHBOUR]

    def before(self, keyframe_id: int) -> tuple[list[Keyframe], Float32]:
        """Places up to a keyframe id, oldest first, and their descriptors (P, D)."""
        known = [place for pair in self._pairs for place in pair if place[0].id <= keyframe_id]
        vectors = [vector for _, vector in known]
        return [k for k, _ in known], np.stack(vectors) if vectors else np.zeros((0, 0), np.float32)


class PlaceLoops:
    """Loop finder with all places of a drive; the result depends only on the windows.

    camera_of: camera of a place by its id, of places of other drives; None: that of the window.
    """

    def __init__(
        self,
        config: LoopConfig,
        descriptor: PlaceDescriptor | None = None,
        camera_of: Callable[[int], Camera] | None = None,
    ) -> None:
        self._config, self._camera_of = config, camera_of
        self._descriptor = descriptor or GradientLayout()
        self._memory = PlaceMemory(config.max_places)
        self._described: dict[int, Float32] = {}
        self._last_found: int | None = None

    def find(
        self, window: SubmapWindow, images: Sequence[Bytes], kit: KnownKit | None
    ) -> LoopCandidate | None:
        """Return the first of the `top_k` most similar places that geometry confirms.

        images: (H, W, 3) uint8 BGR, in batch order. kit: None before the first sub-map; then
        nothing is found.
        """
        new = range(min(window.n_overlap, len(window.primary)), len(window.primary))
        queried = new[::EVERY]
        with ThreadPoolExecutor(DESCRIBERS) as pool:
            vectors = pool.map(self._descriptor.describe, [images[view] for view in queried])
        ids = [window.primary[view].id for view in queried]
        self._described = dict(zip(ids, vectors, strict=True))
        if kit is None or not window.assistant:
            return None
        views = [view for view in queried if self._may_close(window.primary[view].id)]
        verifier = _Verifier(window, images, kit, self._config.min_matches, self._camera_of)
        for view, place in self._most_similar(window, views):
            found = verifier.same_place(view, place)
            if found is not None and found.is_same and self._confirmed(verifier, view, place):
                self._last_found = window.primary[view].id
                return LoopCandidate(view, place, found.T_query_match)
        return None

    def taken(self) -> dict[int, Float32]:
        """Take the descriptors of the last window, to be remembered later."""
        found, self._described = self._described, {}
        return found

    def remember(
        self, window: SubmapWindow, described: Mapping[int, Float32] | None = None
    ) -> None:
        """Add the places of a window. described: of `taken`; None: those of the last `find`."""
        vectors = self.taken() if described is None else described
        for keyframe in window.primary:
            if keyframe.id in vectors:
                self._memory.add(keyframe, vectors[keyframe.id])

    def _may_close(self, query_id: int) -> bool:
        return self._last_found is None or query_id - self._last_found >= CLOSURE_GAP

    def _most_similar(self, window: SubmapWindow, views: list[int]) -> list[tuple[int, Keyframe]]:
        """Select the `top_k` most similar (view, place) pairs, best first, no place twice."""
        if not views:
            return []
        ids = np.array([window.primary[view].id for view in views])
        places, vectors = self._memory.before(int(ids.max()) - self._config.min_gap)
        if not places:
            return []
        place_ids = np.array([place.id for place in places])
        queries = np.stack([self._described[int(i)] for i in ids])
        score = np.array(self._descriptor.similarity(queries, vectors), np.float64)
        score[place_ids[None] > ids[:, None] - self._config.min_gap] = -np.inf
        pairs: list[tuple[int, Keyframe]] = []
        while len(pairs) < self._config.top_k:
            query, place = np.unravel_index(int(score.argmax()), score.shape)
            if score[query, place] < self._descriptor.min_similarity:
                break
            pairs.append((views[query], places[place]))
            score[:, np.abs(place_ids - place_ids[place]) < SUPPRESSION] = -np.inf
        return pairs

    def _confirmed(self, verifier: _Verifier, view: int, place: Keyframe) -> bool:
        """Whether the loop also holds for the neighbours of the place: for one, and against none.

        A single place is often similar by chance. Neighbours with too few matches do not count.
        """
        last = len(verifier.window.primary) - 1
        decided: list[bool] = []
        for other in self._memory.neighbours(place):
            there = min(max(view + other.id - place.id, 0), last)
            found = verifier.same_place(there, other) if there != view else None
            if found is not None:
                decided.append(found.is_same)
        return bool(decided) and all(decided)


class _Verifier:
    """Geometric verification for one window; features are detected on first use."""

    def __init__(
        self,
        window: SubmapWindow,
        images: Sequence[Bytes],
        kit: KnownKit,
        min_matches: int,
        camera_of: Callable[[int], Camera] | None = None,
    ) -> None:
        self.window, self._camera_of = window, camera_of
        self._images, self._kit, self._min_matches = images, kit, min_matches
        self._detected: dict[int, sift.Features] = {}

    def same_place(self, view: int, place: Keyframe) -> SamePlace | None:
        """Compare a place with a primary view and the assistant view nearest in time."""
        t_ns = self.window.primary[view].frame.t_ns
        gaps = [abs(keyframe.frame.t_ns - t_ns) for keyframe in self.window.assistant]
        partner = len(self.window.primary) + int(np.argmin(gaps))
        past = sift.detect(place.frame.gray(), MAX_FEATURES)
        size = np.array(self._images[view].shape[1::-1], np.int64)
        camera = None if self._camera_of is None else self._camera_of(place.id)
        current = self._features(view), self._features(partner)
        return same_place(*current, past, self._kit, size, self._min_matches, camera)

    def _features(self, index: int) -> sift.Features:
        if index not in self._detected:
            gray = np.asarray(cv2.cvtColor(self._images[index], cv2.COLOR_BGR2GRAY), np.uint8)
            self._detected[index] = sift.detect(gray, MAX_FEATURES)
        return self._detected[index]
