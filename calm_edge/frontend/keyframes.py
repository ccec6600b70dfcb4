"""Select keyframes by image disparity (paper IV-A); tau_flow refers to a reference width."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.config import FrontendConfig
from calm_edge.geometry.flow import corners, follow, long_side
from calm_edge.types import Bytes, Float32, Keyframe
from device.frame import Frame

# Half of an open scene is too far to have parallax: the mean is over the half of the tracks with
# the largest disparity, without the largest tenth. MOVING_QUANTILE of the disparities also has to
# exceed MOVING_SHARE of the threshold, so that another moving car does not cause keyframes.
MOVING_HALF = (0.5, 0.9)
MOVING_QUANTILE = 0.75
MOVING_SHARE = 0.2
# factor on the distance of keyframes while the estimator is behind
SPARSE_STRETCH = 2.0
# A smaller share of surviving tracks (turns, near ground) gives a keyframe at once.
SURVIVING_SHARE = 0.5
MIN_TRACKS = 20
CORNERS = 400


def robust_mean(disparity: NDArray[np.floating]) -> float:
    """Mean of the disparities (M,) px between the quantiles MOVING_HALF; 0 if empty."""
    if len(disparity) == 0:
        return 0.0
    low, high = (int(q * len(disparity)) for q in MOVING_HALF)
    return float(np.sort(disparity)[low : max(high, low + 1)].mean())


class KeyframeSelector:
    """Selects keyframes among primary frames, by the disparity of corners since the last keyframe.

    Features are tracked from frame to frame, so that large motions can be followed. At standstill
    the reference image is kept, so that noise does not add up. sparse: select keyframes
    SPARSE_STRETCH times as far apart.
    """

    def __init__(self, config: FrontendConfig, first_id: int = 0) -> None:
        self.config = config
        self.count = first_id
        self.sparse = False
        self._reference: Bytes | None = None
        self._keyframe_t_ns = 0
        self._n_detected = 0
        self._at_keyframe: Float32 = np.zeros((0, 2), np.float32)
        self._uv: Float32 = self._at_keyframe

    def consider(self, frame: Frame, gray: Bytes) -> Keyframe | None:
        """Return the frame as a keyframe if it is selected. gray: its image, (H, W) uint8."""
        if self._reference is None or gray.shape != self._reference.shape:
            return self._accept(frame, gray)
        if self._n_detected < MIN_TRACKS:
            # too few tracks (darkness, fog): detect again
            self._detect(gray)
            return None
        moved, good = follow(self._reference, gray, self._uv)
        stretch = SPARSE_STRETCH if self.sparse else 1.0
        flow_px, max_gap_s = (
            stretch * v for v in (self.config.flow_px, self.config.max_keyframe_gap_s)
        )
        threshold = flow_px * long_side(gray) / self.config.flow_reference_width_px
        disparity = np.linalg.norm(moved - self._at_keyframe, axis=1)[good]
        alive = int(good.sum())
        if alive < max(MIN_TRACKS, SURVIVING_SHARE * self._n_detected):
            return self._accept(frame, gray)
        mean = robust_mean(disparity)
        moving = float(np.quantile(disparity, MOVING_QUANTILE)) > MOVING_SHARE * threshold
        overdue = frame.t_ns - self._keyframe_t_ns > max_gap_s * 1e9
        if moving and (mean > threshold or overdue):
            return self._accept(frame, gray)
        step = np.linalg.norm(moved - self._uv, axis=1)[good]
        if float(np.median(step)) >= self.config.standstill_px:
            self._reference = gray
            self._uv, self._at_keyframe = moved[good], self._at_keyframe[good]
        return None

    def _accept(self, frame: Frame, gray: Bytes) -> Keyframe:
        keyframe = Keyframe(self.count, frame)
        self.count += 1
        self._keyframe_t_ns = frame.t_ns
        self._detect(gray)
        return keyframe

    def _detect(self, gray: Bytes) -> None:
        self._reference = gray
        self._uv = self._at_keyframe = corners(gray, CORNERS)
        self._n_detected = len(self._uv)
