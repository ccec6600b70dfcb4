"""From a backbone's raw sub-map to world units: section V, the assistant's clock, then IV-B.

Scale comes after the correction of poses: with a wrong focal the lateral spacing is wrong while
forward motion is kept, so the other order would put the focal's error into the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.config import Config
from calm_edge.correction.intrinsic_search import IntrinsicSearch
from calm_edge.correction.rectify import rectified
from calm_edge.estimator import scale
from calm_edge.estimator.time_offset import ClockOffset
from calm_edge.types import Bytes, Float, GlobalIntrinsics, Landmarks, Submap

# What is placed is rectified again when the lateness moved by this, or by half its sigma.
LATENESS_MOVED_S = 0.001


@dataclass(frozen=True, slots=True)
class Held:
    """What is held true at one moment: of the intrinsics, None before the search knows any, and
    of how late [s] the assistant's stamps are.
    """

    intrinsics: GlobalIntrinsics | None
    late_s: float


class Rectifier:
    """Owns what is held true of the intrinsics and of the assistant's clock.

    learns_kit: whether the backbone itself finds both over the whole drive, as `bundle` does;
    then its sub-maps are only scaled, unless `correction.apply` says otherwise.
    """

    def __init__(self, config: Config, learns_kit: bool) -> None:
        self._config = config
        apply = config.correction.apply
        corrects = apply == "always" or (apply == "auto" and not learns_kit)
        self._search = IntrinsicSearch(config.correction) if corrects else None
        self._clock = None if learns_kit else ClockOffset()
        self._late_s = 0.0
        self._first: tuple[int, float] | None = None

    @property
    def intrinsics(self) -> GlobalIntrinsics | None:
        """What the online search holds true (V-A); None where it does not run, or at first."""
        return self._search.intrinsics if self._search else None

    def learn(
        self, raw: Submap, landmarks: Landmarks | None, images: Sequence[Bytes] | None
    ) -> bool:
        """Takes in one raw sub-map; whether those placed must be rectified again.

        landmarks: the backbone's, images: (H, W, 3) BGR, in batch order, as matches need them.
        """
        changed = self._search.add(raw, landmarks, images) if self._search else False
        if self._clock is None:
            return changed
        self._clock.add(self._corrected(raw))
        return self._take_lateness() or changed

    def finish(self) -> bool:
        """Ends what is still being measured; as `learn`."""
        return self._search.finish() if self._search else False

    @property
    def held(self) -> Held:
        """What is held true now."""
        return Held(self.intrinsics, self._late_s)

    def rectify(self, submap: Submap, held: Held | None = None) -> Submap:
        """The sub-map anew from its raw poses and cameras, in world units; raises ScaleError.

        held: what was held true once, None for what is now.
        Without `scale.rectify` the first sub-map's factor serves all, as it was when that one was
        last rectified: where all are, it has to come first.
        """
        raw = replace(submap, T_s_c=submap.T_s_c_raw, cameras=submap.cameras_raw, scale=1.0)
        corrected = self._corrected(raw, held)
        if self._config.scale.rectify or self._first is None or self._first[0] == submap.id:
            scaled = scale.rectify(corrected, self._config.scale.spacing)
            if not self._config.scale.rectify:
                self._first = submap.id, scaled.scale
            return scaled
        if not submap.assistant_ids:
            raise scale.ScaleError("no assistant keyframe ties this sub-map to the rig")
        _, world_units = self._first
        T_s_c = scale.rectified(corrected.T_s_c, world_units)
        return replace(corrected, scale=world_units, T_s_c=T_s_c)

    def _corrected(self, raw: Submap, held: Held | None = None) -> Submap:
        """Section V with what is held true, None for now, still in the raw unit."""
        held = held or self.held
        if self._clock is not None:
            raw = replace(raw, assistant_late_ns=round(held.late_s * 1e9))
        intrinsics = held.intrinsics
        if intrinsics is None or not raw.assistant_ids:
            return raw
        sigma = _effective_sigma(raw, intrinsics)
        return replace(rectified(raw, intrinsics, self._config.correction), focal_log_sigma=sigma)

    def _take_lateness(self) -> bool:
        assert self._clock is not None
        told = self._clock.lateness
        late_s = told.late_s if told.observed else 0.0
        if abs(late_s - self._late_s) < max(LATENESS_MOVED_S, told.sigma_s / 2):
            return False
        self._late_s = late_s
        return True


def _effective_sigma(raw: Submap, held: GlobalIntrinsics) -> Float:
    """(2,) of the log focals in use: what the search is unsure of, and what damping left in."""
    estimated = np.array([raw.cameras_raw[view].fx for view in (0, raw.n_primary)])
    left = np.log(estimated / held.focals) * (1 - held.damping)
    return np.hypot(held.focal_log_sigma, left)
