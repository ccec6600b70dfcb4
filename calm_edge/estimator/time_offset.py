"""How late the assistant's stamps are against the primary's, from the poses of both.

Past the paper, which takes stamps as true: a host stamps what has arrived, and two cameras need
not be equally quick. Were the stamps right, every assistant view would sit on one rig; lateness
moves it off by the car's own motion, T_p_a -> exp(twist * late) T_p_a. Turning and changes of
speed tell the two apart; at constant velocity on a straight the rig's forward offset explains it
as well, and lateness is unobserved.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Submap

# What is thought of two cameras' clocks before they have been seen.
PRIOR_SIGMA_S = 0.02
# What poses bent by a wrong focal feign in turns: up to 11 ms on scripted drives that had none.
FEIGNED_SIGMA_S = 0.006
# A lateness of fewer sigmas is no knowledge: the stamps are taken as they are.
TOLD_SIGMAS = 2.0
LARGEST_S = 0.1
MAX_SUBMAPS = 200
MIN_SUBMAPS = 5
# How far the poses of one sub-map are thought to sit off the rig, to weigh translation (in
# spacings) against rotation; the sigma is measured, though never taken for under a tenth of that.
TRANSLATION_NOISE = 0.02
ROTATION_NOISE_RAD = 0.002
LEAST_NOISE = 0.1
ITERATIONS = 8
# Frames to either side over which the car's motion is taken: between two alone it is mostly noise.
SMOOTHING = 2


@dataclass(frozen=True, slots=True)
class Samples:
    """One sub-map's assistant views against the primary at their stamps.

    T_p_a: (V, 4, 4), raw unit. twist: (V, 6) of the primary there, raw units and rad a second,
    the mean over span_s: (V,).
    """

    T_p_a: Float
    twist: Float
    span_s: Float


@dataclass(frozen=True, slots=True)
class Lateness:
    """late_s: how much later than stamped the assistant was exposed. sigma_s: one sigma of it."""

    late_s: float
    sigma_s: float

    @property
    def observed(self) -> bool:
        """Whether it is told from none, and the drive rather than the prior says so."""
        known = self.sigma_s < PRIOR_SIGMA_S / 2
        return known and abs(self.late_s) > TOLD_SIGMAS * self.sigma_s


def samples(submap: Submap) -> Samples | None:
    """What one sub-map shows; None where it has no two primary and one assistant views.

    Assistant views outside the span of the primary's by more than a frame gap are left out.
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
    # the mean motion as seen from where the primary is now, not from where the span began
    step = se3.inverse(T_s_ref) @ T_s_p[last] @ se3.inverse(T_s_p[first]) @ T_s_ref
    return Samples(se3.inverse(T_s_ref) @ T_s_a, se3.log(step) / span[:, None], span)


def estimate(history: list[Samples]) -> Lateness:
    """The lateness under which the assistant sits most nearly on one rig, with the prior.

    Gauss-Newton over lateness, rig and each sub-map's scale; the sigma is from the scatter of
    whole sub-maps (a sandwich), as the errors within one are not independent.
    """
    late = 0.0
    sigma = PRIOR_SIGMA_S
    for _ in range(ITERATIONS):
        step, sigma = _step(history, late)
        late = float(np.clip(late + step, -LARGEST_S, LARGEST_S))
        if abs(step) < 1e-6:
            break
    return Lateness(late, float(np.hypot(sigma, FEIGNED_SIGMA_S)))


def _step(history: list[Samples], late: float) -> tuple[float, float]:
    """(Gauss-Newton step of the lateness, its sigma), both seconds."""
    r, J, k = _residuals(history, late)
    # the rig's own six parameters are what all samples share: projected out by their mean
    J_free, r_free = J - J.mean(0), r - r.mean(0)
    H = float((J_free * J_free).sum())
    # noise in the poses makes motion seem to change: what it adds to H tells nothing
    span = np.concatenate([s.span_s for s in history])
    signal = H - float((r_free**2).mean() * (6 / span**2).sum())
    if signal <= 0:
        return -late, PRIOR_SIGMA_S
    score = np.bincount(k, (J_free * r_free).sum(1))
    scatter = float((score - score.mean()) @ (score - score.mean()))
    information = signal**2 / max(scatter, LEAST_NOISE**2 * signal)
    total = information + PRIOR_SIGMA_S**-2
    found = late + float(score.sum()) / H
    return found * information / total - late, total**-0.5


def _residuals(history: list[Samples], late: float) -> tuple[Float, Float, np.ndarray]:
    """Whitened residuals (V, 6), derivatives (V, 6) by lateness, sub-map (V,) of every sample."""
    k = np.repeat(np.arange(len(history)), [len(s.T_p_a) for s in history])
    T = np.concatenate([s.T_p_a for s in history])
    twist = np.concatenate([s.twist for s in history])
    # T_p_a as it would be had the stamp been `late` later
    moved = se3.exp(-twist * late) @ T
    # each sub-map's own unit is its spacing
    length = np.bincount(k, np.linalg.norm(moved[:, :3, 3], axis=1)) / np.bincount(k)
    moved[:, :3, 3] /= length[k, None]
    velocity = twist[:, :3] / length[k, None]
    rig = se3.mean(moved)
    to_rig = se3.log(se3.inverse(rig) @ moved)
    # moving the instant moves the assistant by the primary's motion, seen from the assistant
    motion = np.concatenate([velocity, twist[:, 3:]], 1)
    J = (se3.adjoint(se3.inverse(rig)) @ motion[..., None])[..., 0]
    # the mean length is one whatever the lateness: what moves it is taken back with the scale
    along = rig[:3, :3].T @ rig[:3, 3]
    pull = np.bincount(k, J[:, :3] @ along) / np.bincount(k)
    J[:, :3] -= pull[k, None] * along
    sigma = np.repeat([TRANSLATION_NOISE, ROTATION_NOISE_RAD], 3)
    return to_rig / sigma, J / sigma, k


class ClockOffset:
    """Owns the samples of the most recent sub-maps; `lateness` is what they say together."""

    def __init__(self) -> None:
        self._history: deque[Samples] = deque(maxlen=MAX_SUBMAPS)
        self.lateness = Lateness(0.0, PRIOR_SIGMA_S)

    def add(self, submap: Submap) -> None:
        """Takes in a sub-map with corrected poses, in its raw unit."""
        found = samples(submap)
        if found is None:
            return
        self._history.append(found)
        if len(self._history) >= MIN_SUBMAPS:
            self.lateness = estimate(list(self._history))
