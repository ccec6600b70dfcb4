"""Detect a jump between two consecutive poses."""

from __future__ import annotations

import math

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import PoseSample

# Largest plausible deviation from motion at constant velocity, also on a bad road: JUMP_M +
# ACCELERATION_M_S2 t²/2, t being the time between two poses; likewise for the rotation.
JUMP_M, ACCELERATION_M_S2 = 0.5, 20.0
JUMP_RAD, ACCELERATION_RAD_S2 = math.radians(5.0), 10.0


def jumped(before: PoseSample, after: PoseSample) -> bool:
    """True if a car with pose and velocity `before` cannot have reached the pose `after`.

    Lengths are in metres. False if the velocity is unknown (NaN).
    """
    dt = (after.t_ns - before.t_ns) * 1e-9
    T = se3.inverse(before.T_w_c) @ after.T_w_c
    off = float(np.linalg.norm(T[:3, 3] - before.velocity_c * dt))
    turned = float(np.linalg.norm(se3.so3_log(T[:3, :3]) - before.turn_rate_c * dt))
    return (
        off > JUMP_M + ACCELERATION_M_S2 * dt**2 / 2
        or turned > JUMP_RAD + ACCELERATION_RAD_S2 * dt**2 / 2
    )
