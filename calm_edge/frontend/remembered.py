"""Past frames and current tracks of the tracker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calm_edge.frontend.submap_errors import SubmapErrors
from calm_edge.geometry.camera import Camera
from calm_edge.types import Bytes, Float, Float32

# Largest age and number of past frames that are kept. The points of a new sub-map are tracked
# through them, from its keyframes to the newest frame.
REMEMBERED_NS, MAX_REMEMBERED = 12_000_000_000, 360
# Error of the log of lengths when all points are the tracker's own: it triangulates them as soon as
# their parallax passes a limit, which favours parallax that is too large.
OWN_SCALE_SIGMA = 0.02


@dataclass(slots=True)
class PastFrame:
    """A frame: gray (H, W), and T_m_c (4, 4) camera->map, None if it could not be localised.

    keyframe_id: None if it is no keyframe.
    """

    t_ns: int
    gray: Bytes
    keyframe_id: int | None
    T_m_c: Float | None


@dataclass(slots=True)
class Tracks:
    """Tracked points: p_m (M, 3) map frame, at pixels uv (M, 2) of the image `seen_in`.

    submap_errors: of the sub-map of the points. own: share of the points that the tracker has
    triangulated itself.
    """

    camera: Camera
    p_m: Float
    uv: Float32
    seen_in: Bytes
    submap_errors: SubmapErrors
    own: float = 0.0

    @property
    def errors(self) -> SubmapErrors:
        """Errors of the motion of poses located by these points."""
        scale = float(np.hypot(self.submap_errors.scale_log_sigma, OWN_SCALE_SIGMA * self.own))
        return replace(self.submap_errors, scale_log_sigma=scale)


def spaced(t_ns: Sequence[int], since_ns: int, gap_ns: int) -> list[int]:
    """Indices of times after since_ns that are at least gap_ns apart, and of the last one.

    Bounds the number of frames to track, independently of the frame rate.
    """
    chosen, before = [], since_ns
    for i, t in enumerate(t_ns):
        if t - before >= gap_ns or (i == len(t_ns) - 1 and t > before):
            chosen.append(i)
            before = t
    return chosen
