"""Rectify raw sub-maps: pose correction (paper V), time offset, then scale (paper IV-B).

The scale is computed from corrected poses: a wrong focal length changes the lateral spacing but
not the forward motion, so in the other order its error would enter the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.config import Config
from calm_edge.correction.intrinsic_search import LENS_MOVED_PX, IntrinsicSearch
from calm_edge.correction.rectify import rectified
from calm_edge.estimator import scale
from calm_edge.estimator.time_offset import TimeOffsetEstimator
from calm_edge.geometry.through_lens import lens_moved_px, lens_of
from calm_edge.types import Bytes, Float, GlobalIntrinsics, Landmarks, Submap

# Placed sub-maps are rectified again once the time offset has changed by the larger of this and
# half its sigma.
OFFSET_MOVED_S = 0.001


@dataclass(frozen=True, slots=True)
class Calibration:
    """Estimates of the intrinsics and of the time offset.

    intrinsics: newest last, each for the lenses of its cameras. offset_s: 0 while it is unobserved.
    """

    intrinsics: tuple[GlobalIntrinsics, ...]
    offset_s: float

    def intrinsics_of(self, submap: Submap) -> GlobalIntrinsics | None:
        """The newest estimate for the lenses with which a sub-map of both eyes was solved."""
        cameras = submap.cameras[0], submap.cameras[submap.n_primary]
        for intrinsics in reversed(self.intrinsics):
            pairs = zip(cameras, intrinsics.cameras, strict=True)
            moved = (lens_moved_px(lens_of(one), lens_of(other)) for one, other in pairs)
            if max(moved) <= LENS_MOVED_PX:
                return intrinsics
        return None


class Rectifier:
    """Corrects and scales raw sub-maps; estimates intrinsics and time offset from them.

    estimates_kit: the backbone itself estimates intrinsics and time offset, as `bundle` does. Then
    sub-maps are only scaled, unless `correction.apply` is `always`.
    """

    def __init__(self, config: Config, estimates_kit: bool) -> None:
        self._config = config
        apply = config.correction.apply
        corrects = apply == "always" or (apply == "auto" and not estimates_kit)
        self._search = IntrinsicSearch(config.correction) if corrects else None
        self._clock = None if estimates_kit else TimeOffsetEstimator()
        self._offset_s = 0.0
        self._first: tuple[int, float] | None = None

    @property
    def intrinsics(self) -> GlobalIntrinsics | None:
        """Result of the online intrinsic search (V-A); None if it is off or has no result yet."""
        return self._search.intrinsics if self._search else None

    def update(
        self, raw: Submap, landmarks: Landmarks | None, images: Sequence[Bytes] | None
    ) -> bool:
        """Add a raw sub-map; return whether placed sub-maps have to be rectified again.

        landmarks: of the backbone. images: (H, W, 3) BGR in batch order, for SIFT matches.
        """
        changed = self._search.add(raw, landmarks, images) if self._search else False
        if self._clock is None:
            return changed
        self._clock.add(self._corrected(raw))
        return self._update_offset() or changed

    def finish(self) -> bool:
        """Finish pending measurements; return whether sub-maps have to be rectified again."""
        return self._search.finish() if self._search else False

    @property
    def calibration(self) -> Calibration:
        """The current estimates."""
        search = self._search
        newest = () if search is None or search.intrinsics is None else (search.intrinsics,)
        return Calibration((*(search.earlier if search else ()), *newest), self._offset_s)

    def rectify(self, submap: Submap, calibration: Calibration | None = None) -> Submap:
        """Rectify a sub-map from its raw poses and cameras; raises ScaleError.

        calibration: None for the current one. If `scale.rectify` is false, all sub-maps get the
        scale of the first one; so that one must be rectified again before the others.
        """
        raw = replace(submap, T_s_c=submap.T_s_c_raw, cameras=submap.cameras_raw, scale=1.0)
        corrected = self._corrected(raw, calibration)
        if self._config.scale.rectify or self._first is None or self._first[0] == submap.id:
            scaled = scale.rectify(corrected, self._config.scale.spacing)
            if self._clock is not None:
                scaled = replace(scaled, scale_log_sigma=scale.scatter(scaled))
            if not self._config.scale.rectify:
                self._first = submap.id, scaled.scale
            return scaled
        if not submap.assistant_ids:
            raise scale.ScaleError("the sub-map has no assistant keyframe, so its scale is unknown")
        _, world_units = self._first
        T_s_c = scale.rectified(corrected.T_s_c, world_units)
        return replace(corrected, scale=world_units, T_s_c=T_s_c)

    def _corrected(self, raw: Submap, calibration: Calibration | None = None) -> Submap:
        """Apply time offset and pose correction (paper V); the result is in raw units."""
        calibration = calibration or self.calibration
        if self._clock is not None:
            raw = replace(raw, assistant_late_ns=round(calibration.offset_s * 1e9))
        intrinsics = calibration.intrinsics_of(raw) if raw.assistant_ids else None
        if intrinsics is None:
            return raw
        sigma = _effective_sigma(raw, intrinsics)
        return replace(rectified(raw, intrinsics, self._config.correction), focal_log_sigma=sigma)

    def _update_offset(self) -> bool:
        assert self._clock is not None
        found = self._clock.offset
        offset_s = found.offset_s if found.observed else 0.0
        if abs(offset_s - self._offset_s) < max(OFFSET_MOVED_S, found.sigma_s / 2):
            return False
        self._offset_s = offset_s
        return True


def _effective_sigma(raw: Submap, intrinsics: GlobalIntrinsics) -> Float:
    """Sigma (2,) of the log focal lengths of the corrected sub-map.

    Sum in quadrature of the sigma of the intrinsic search, and of the share of the correction that
    is not applied (1 - damping).
    """
    estimated = np.array([raw.cameras_raw[view].fx for view in (0, raw.n_primary)])
    left = np.log(estimated / intrinsics.focals) * (1 - intrinsics.damping)
    return np.hypot(intrinsics.focal_log_sigma, left)
