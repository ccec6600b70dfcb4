"""Time offset between the cameras' stamps, estimated from the poses of both (not in the paper).

A host stamps an image when it arrives, and two cameras may differ in delay. With correct stamps
all assistant views lie on one rigid rig; an offset displaces them by the car's own motion,
T_p_a -> exp(twist * offset) T_p_a. Turns and changes of speed make it observable; at constant
velocity on a straight it cannot be distinguished from the rig's forward position.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Submap

# Sigma of the prior of the offset; its mean is zero.
PRIOR_SIGMA_S = 0.02
# Sigma of the systematic error, added in quadrature: in turns, the errors of poses due to a wrong
# focal length resemble a time offset. Up to 11 ms were estimated on scripted drives without offset.
SYSTEMATIC_SIGMA_S = 0.006
# An estimate of at most this many of its sigmas is not significant and is not applied.
SIGNIFICANT_SIGMAS = 2.0
MAX_OFFSET_S = 0.1
MAX_SUBMAPS = 200
MIN_SUBMAPS = 5
# Assumed sigmas of T_p_a, of translation [spacings] and rotation [rad], by which residuals are
# divided. The sigma of the offset follows from the scatter of the residuals instead, which is taken
# as no less than MIN_NOISE times the assumed sigmas.
TRANSLATION_NOISE = 0.02
ROTATION_NOISE_RAD = 0.002
MIN_NOISE = 0.1
ITERATIONS = 8
# Number of frames on either side over which the car's motion is averaged: the motion between two
# consecutive frames is mostly noise.
SMOOTHING = 2


@dataclass(frozen=True, slots=True)
class Samples:
    """Rig and motion of the primary camera at the stamp of each assistant view of a sub-map.

    T_p_a: (V, 4, 4), raw units. twist: (V, 6) velocity [raw units/s] and turn rate [rad/s] of the
    primary in its own axes, averaged over span_s (V,) seconds around the stamp.
    """

    T_p_a: Float
    twist: Float
    span_s: Float


@dataclass(frozen=True, slots=True)
class TimeOffset:
    """Estimated time offset (time of exposure minus stamp of the assistant) and its sigma."""

    offset_s: float
    sigma_s: float

    @property
    def observed(self) -> bool:
        """Whether the offset is significant and determined by the motion, not by the prior."""
        known = self.sigma_s < PRIOR_SIGMA_S / 2
        return known and abs(self.offset_s) > SIGNIFICANT_SIGMAS * self.sigma_s


def samples(submap: Submap) -> Samples | None:
    """Compute the samples of a sub-map; None if it has too few views.

    Two primary views and one assistant view are needed. Assistant views more than one frame gap
    before the first or after the last primary view are left out.
    """
    n, m = submap.n_primary, len(submap.assistant_ids)
    if n < 2 or m < 1:
        return None
    t = (submap.t_ns - submap.t_ns[0]) * 1e-9
    t_p, t_a = t[:n], t[n : n + m]
    gap = np.diff(t_p)
    if np.any(gap <= 0):
        return None
    valid = (t_a >= -gap[0]) & (t_a <= t_p[-1] + gap[-1])
    if not valid.any():
        return None
    T_s_p, T_s_a = submap.T_s_c[:n], submap.T_s_c[n : n + m][valid]
    i = np.clip(np.searchsorted(t_p, t_a[valid], side="right") - 1, 0, n - 2)
    first, last = np.maximum(i - SMOOTHING, 0), np.minimum(i + 1 + SMOOTHING, n - 1)
    span = t_p[last] - t_p[first]
    T_s_ref = se3.interpolate_at(t_p, T_s_p, t_a[valid])
    # motion from first to last view, in the axes of the primary at the assistant's stamp
    step = se3.inverse(T_s_ref) @ T_s_p[last] @ se3.inverse(T_s_p[first]) @ T_s_ref
    return Samples(se3.inverse(T_s_ref) @ T_s_a, se3.log(step) / span[:, None], span)


def estimate(history: list[Samples]) -> TimeOffset:
    """Maximum a posteriori time offset, given that all assistant views have the same T_p_a.

    Gauss-Newton over offset, rig and the scale of each sub-map. The sigma is a sandwich estimate
    clustered by sub-map (Liang and Zeger, 1986), because errors within one are correlated.
    """
    offset = 0.0
    sigma = PRIOR_SIGMA_S
    for _ in range(ITERATIONS):
        step, sigma = _step(history, offset)
        offset = float(np.clip(offset + step, -MAX_OFFSET_S, MAX_OFFSET_S))
        if abs(step) < 1e-6:
            break
    return TimeOffset(offset, float(np.hypot(sigma, SYSTEMATIC_SIGMA_S)))


def _step(history: list[Samples], offset: float) -> tuple[float, float]:
    """Return the Gauss-Newton step of the offset, and the sigma of the offset, both in seconds."""
    r, J, k = _residuals(history, offset)
    # subtracting the mean projects out the six parameters of the rig
    J_free, r_free = J - J.mean(0), r - r.mean(0)
    H = float((J_free * J_free).sum())
    # H, the information on the offset, is too large by the noise of the twists: subtract its
    # expected share, from the residuals' mean square (two noisy poses, span_s apart)
    span = np.concatenate([s.span_s for s in history])
    signal = H - float((r_free**2).mean() * (6 / span**2).sum())
    if signal <= 0:
        return -offset, PRIOR_SIGMA_S
    score = np.bincount(k, (J_free * r_free).sum(1))
    scatter = float((score - score.mean()) @ (score - score.mean()))
    information = signal**2 / max(scatter, MIN_NOISE**2 * signal)
    total = information + PRIOR_SIGMA_S**-2
    found = offset + float(score.sum()) / H
    return found * information / total - offset, total**-0.5


def _residuals(history: list[Samples], offset: float) -> tuple[Float, Float, np.ndarray]:
    """Residuals (V, 6) of T_p_a against its mean over all V views, for a given offset.

    Divided by the assumed sigmas. Also returns minus their derivatives (V, 6) by the offset, and
    the index (V,) in `history` of each view's sub-map.
    """
    k = np.repeat(np.arange(len(history)), [len(s.T_p_a) for s in history])
    T = np.concatenate([s.T_p_a for s in history])
    twist = np.concatenate([s.twist for s in history])
    # T_p_a if the assistant was exposed `offset` later than its stamps
    moved = se3.exp(-twist * offset) @ T
    # convert lengths from each sub-map's raw units to spacings: its mean |t_p_a| becomes 1
    length = np.bincount(k, np.linalg.norm(moved[:, :3, 3], axis=1)) / np.bincount(k)
    moved[:, :3, 3] /= length[k, None]
    velocity = twist[:, :3] / length[k, None]
    rig = se3.mean(moved)
    to_rig = se3.log(se3.inverse(rig) @ moved)
    # per second of offset T_p_a moves by the twist: the same motion in the assistant's axes
    motion = np.concatenate([velocity, twist[:, 3:]], 1)
    J = (se3.adjoint(se3.inverse(rig)) @ motion[..., None])[..., 0]
    # the mean |t_p_a| of a sub-map is 1 for any offset: remove the part of J that changes it
    along = rig[:3, :3].T @ rig[:3, 3]
    pull = np.bincount(k, J[:, :3] @ along) / np.bincount(k)
    J[:, :3] -= pull[k, None] * along
    sigma = np.repeat([TRANSLATION_NOISE, ROTATION_NOISE_RAD], 3)
    return to_rig / sigma, J / sigma, k


class TimeOffsetEstimator:
    """Estimates `offset` from the samples of the newest MAX_SUBMAPS sub-maps, which it stores."""

    def __init__(self) -> None:
        self._history: deque[Samples] = deque(maxlen=MAX_SUBMAPS)
        self.offset = TimeOffset(0.0, PRIOR_SIGMA_S)

    def add(self, submap: Submap) -> None:
        """Estimate `offset` again with one more sub-map: poses corrected (paper V), raw units."""
        found = samples(submap)
        if found is None:
            return
        self._history.append(found)
        if len(self._history) >= MIN_SUBMAPS:
            self.offset = estimate(list(self._history))
