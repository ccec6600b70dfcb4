"""Online intrinsic search for both cameras (paper V-A), and their damping (V-C)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction.eye_search import EyeSearch, median
from calm_edge.correction.matches import PairMatches, from_landmarks, from_sift
from calm_edge.correction.pool import pooled
from calm_edge.correction.test_bank import GroupBuilder, GroupSource
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.through_lens import lens_moved_px, lens_of
from calm_edge.types import Bytes, GlobalIntrinsics, Landmarks, Submap
from device.frame import Eye

# Sub-maps are rectified again if the log focal has changed by more than both of these: an absolute
# threshold, and a share of its sigma.
_MOVED_LOG = 0.005
_MOVED_SIGMAS = 0.5
# The bank holds for one lens: if it moves by more than this anywhere in the picture, candidates are
# collected anew, and the matrices are estimated again.
LENS_MOVED_PX = 1.0


class IntrinsicSearch:
    """Estimates the intrinsics of both cameras from the sub-maps so far; deterministic.

    Time per sub-map is bounded: candidates are limited, and images and landmarks not kept. A test
    group is started every `group_every` sub-maps, alternating between the cameras, and built in as
    many steps; with a full bank, n_group times less often.

    Focal lengths and fundamental matrices are those of undistorted pixels, where the cameras of the
    sub-maps know a lens (`ThroughLens`). When it moves, the groups are built again from the matches
    as taken.
    """

    def __init__(self, config: CorrectionConfig) -> None:
        self._config = config
        self._eyes = {eye: EyeSearch(config) for eye in Eye}
        self._lenses: dict[Eye, Camera | None] = {}
        self._builders: dict[Eye, GroupBuilder] = {}
        self._waiting: dict[Eye, list[GroupSource]] = {eye: [] for eye in Eye}
        self._count = 0
        self._earlier: list[GlobalIntrinsics] = []
        self._current: GlobalIntrinsics | None = None
        self._applied: GlobalIntrinsics | None = None

    @property
    def intrinsics(self) -> GlobalIntrinsics | None:
        """Current estimate; None until there are views of both cameras."""
        return self._current

    @property
    def earlier(self) -> tuple[GlobalIntrinsics, ...]:
        """The last estimates for lenses that have been replaced since, oldest first."""
        return tuple(self._earlier)

    def _estimate(self) -> GlobalIntrinsics | None:
        eyes = [self._eyes[eye] for eye in Eye]
        primary, assistant = (eye.camera for eye in eyes)
        if primary is None or assistant is None:
            return None
        damping = np.array([eye.damping for eye in eyes])
        sigma = np.array([eye.measured.log_sigma for eye in eyes])
        if self._config.weighted:
            measured = np.array([eye.measured.log_focal for eye in eyes])
            n = min(len(eye.log_focals) for eye in eyes)
            guesses = np.stack([eye.log_focals[-n:] for eye in eyes], 1)
            pool = pooled(guesses, measured, sigma)
            primary, assistant = (
                eye.shape().with_focal(focal)
                for eye, focal in zip(eyes, np.exp(pool.log_focal).tolist(), strict=True)
            )
            damping = np.full(2, pool.damping if self._config.adaptive_damping else 1.0)
            sigma = pool.log_sigma
        return GlobalIntrinsics((primary, assistant), damping, sigma)

    def add(
        self, submap: Submap, landmarks: Landmarks | None, images: Sequence[Bytes] | None
    ) -> bool:
        """Add a sub-map; returns whether all sub-maps must be rectified again.

        The candidates are submap.cameras_raw. landmarks: of the backbone. images: (H, W, 3) BGR in
        batch order. Test groups (fundamental matrices of the image pairs of one sub-map) are
        estimated from matches of the landmarks or of SIFT features of the images; without
        these no group is started.
        """
        for eye in Eye:
            views, ids = views_of(submap, eye)
            if not views:
                continue
            camera = median(submap.cameras_raw[view] for view in views)
            self._follow_lens(eye, camera)
            self._eyes[eye].add_candidate(camera)
            self._build(eye)
            if self._waiting[eye] and eye not in self._builders:
                source = self._waiting[eye].pop(0)
                self._builders[eye] = source.builder(self._config, camera)
            elif self._is_due(eye):
                matches = self._matches(views, landmarks, images)
                if matches is not None:
                    self._builders[eye] = GroupBuilder(matches, views, ids, self._config, camera)
        self._count += 1
        return self._has_changed()

    def _follow_lens(self, eye: Eye, camera: Camera) -> None:
        """Restart the search of an eye whose lens has moved; queue its groups to be rebuilt."""
        lens = lens_of(camera)
        if lens_moved_px(self._lenses.setdefault(eye, lens), lens) <= LENS_MOVED_PX:
            return
        if self._current is not None:
            self._earlier.append(self._current)
            self._current = None
        self._lenses[eye] = lens
        self._builders.pop(eye, None)
        sources = [group.source for group in self._eyes[eye].bank.groups]
        self._waiting[eye] = [source for source in sources if source is not None]
        self._eyes[eye] = EyeSearch(self._config)

    def finish(self) -> bool:
        """Finish the test groups being built; returns whether to rectify again, as `add`."""
        for eye in list(self._builders):
            self._close(eye)
        for eye, sources in self._waiting.items():
            while sources:
                self._builders[eye] = sources.pop(0).builder(self._config, self._eyes[eye].shape())
                self._close(eye)
        return self._has_changed()

    def _is_due(self, eye: Eye) -> bool:
        bank, every = self._eyes[eye].bank, self._config.group_every
        # alternate between the cameras, so that no sub-map needs SIFT features of both
        turn = (every // 2) * int(eye)
        if len(bank.groups) >= self._config.n_group:
            # a full bank accepts only a group with more information, which is rare: build fewer
            every *= self._config.n_group
        due = self._count % every == turn
        return due and eye not in self._builders and not bank.is_closed

    def _matches(
        self, views: Sequence[int], landmarks: Landmarks | None, images: Sequence[Bytes] | None
    ) -> PairMatches | None:
        if landmarks is not None and self._config.matches != "sift":
            return from_landmarks(landmarks, views)
        if images is None:
            return None
        return from_sift([images[view] for view in views], views, self._config.max_features)

    def _build(self, eye: Eye) -> None:
        builder = self._builders.get(eye)
        if builder is not None:
            builder.advance()
            if builder.done:
                self._close(eye)

    def _close(self, eye: Eye) -> None:
        group = self._builders.pop(eye).finish(self._eyes[eye].shape())
        if group is not None:
            self._eyes[eye].add_group(group)

    def _has_changed(self) -> bool:
        self._current = self._estimate()
        now, before = self._current, self._applied
        if now is None:
            return False
        if before is None:
            self._applied = now
            return False
        step = (now.damping != before.damping).any()
        moved = np.abs(np.log(now.focals / before.focals))
        enough = np.fmax(_MOVED_LOG, _MOVED_SIGMAS * now.focal_log_sigma)
        if step or ((moved > enough) & (now.damping > 0)).any():
            self._applied = now
            return True
        return False


def views_of(submap: Submap, eye: Eye) -> tuple[list[int], list[int]]:
    """Batch indices and keyframe ids of a camera's views, without a loop keyframe."""
    if eye == Eye.PRIMARY:
        return list(range(submap.n_primary)), list(submap.primary_ids)
    first = submap.n_primary
    return list(range(first, first + len(submap.assistant_ids))), list(submap.assistant_ids)
