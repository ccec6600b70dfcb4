"""Whether a car can have moved as poses say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3

Float = NDArray[np.float64]

# Where nearly all points are far, single steps have all but free lengths at small residuals. No car
# changes its velocity between keyframes by more than both: spacings / s^2 (good windows stay below
# 20, wrong ones exceed 60), and the share of the window's median speed (0.5, 1.3).
MAX_ACCELERATION, MAX_VELOCITY_JUMP = 40.0, 0.7
# spacings / s: 360 km/h with cameras 0.1 m apart
MAX_SPEED = 1000.0
# rad / s: a car that turns on the spot takes 4 s
MAX_TURN_RATE = 1.6


def contradiction(t: Float, T_w_c: Float) -> str:
    """Say why no car moves along poses (N, 4, 4) [spacings] at times (N,) s; empty if one can."""
    dt = np.diff(t)
    step = se3.inverse(T_w_c[:-1]) @ T_w_c[1:]
    velocity = np.diff(T_w_c[:, :3, 3], axis=0) / dt[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    turn_rate = np.linalg.norm(se3.so3_log(step[:, :3, :3]), axis=1) / dt
    jump = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    hard = jump > MAX_ACCELERATION * (dt[1:] + dt[:-1]) / 2
    if np.any(hard & (jump > MAX_VELOCITY_JUMP * np.median(speed))):
        return "the velocity jumps between keyframes as no car's does"
    if np.any(speed > MAX_SPEED):
        return "no car is so fast"
    if np.any(turn_rate > MAX_TURN_RATE):
        return "no car turns so fast"
    return ""
