"""The belief on a kit whose two cameras are exchanged."""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.belief import gaussian
from calm_edge.types import KitBelief


def swapped(belief: KitBelief) -> KitBelief:
    """Exchange primary and assistant: their terms, the inverse rig, the opposite time offset.

    With T_p_a = (R, c) the rig becomes (R^T, -R^T c). The information is transformed to first
    order, by the Jacobian of the exchange.
    """
    belief = gaussian(belief)
    theta, J = belief.mean, np.zeros((layout.SIZE, layout.SIZE))
    for of_eyes in (layout.EYE, layout.FAMILY):
        J[of_eyes, of_eyes[::-1]] = 1.0
    turn, centre = theta[layout.RIG_ROTATION], theta[layout.RIG_CENTRE]
    R_a_p = se3.so3_exp(-turn)
    J[layout.RIG_ROTATION, layout.RIG_ROTATION] = -np.eye(3)
    J[layout.RIG_CENTRE, layout.RIG_CENTRE] = -R_a_p
    J[layout.RIG_CENTRE, layout.RIG_ROTATION] = -se3.hat(R_a_p @ centre) @ se3.so3_left_jacobian(
        -turn
    )
    J[layout.TIME_OFFSET, layout.TIME_OFFSET] = -1.0
    mean = J @ theta
    mean[layout.RIG_CENTRE] = -R_a_p @ centre
    back = np.linalg.inv(J)
    information = back.T @ belief.information @ back
    return KitBelief(mean, (information + information.T) / 2)
