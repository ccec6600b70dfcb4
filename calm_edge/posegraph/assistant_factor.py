"""The pose graph's residuals and their exact derivatives, all of them in one pass (paper IV-C).

Poses move on the right, T <- T exp(d), twists ordered (translation, rotation). The same
residual serves E_pri and E_loop: they are E_ast of a camera mounted at the identity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float


class Linearised(NamedTuple):
    """r (P, 6) and its derivatives (P, 6, 6) by the poses i and j and by T_p_a."""

    r: Float
    by_i: Float
    by_j: Float
    by_rig: Float


def residual(T_j_i: Float, T_w_i: Float, T_w_j: Float, T_p_a: Float) -> Float:
    """log((T_j_i)^-1 (T_w_j T_p_a)^-1 (T_w_i T_p_a)), E_ast of IV-C, unweighted: (P, 6).

    T_j_i: measured, of the assistant. T_w_i, T_w_j: primary. All (P, 4, 4); T_p_a (4, 4).
    """
    return se3.log(se3.inverse(T_j_i) @ se3.inverse(T_w_j @ T_p_a) @ T_w_i @ T_p_a)


def linearise(T_j_i: Float, T_w_i: Float, T_w_j: Float, T_p_a: Float) -> Linearised:
    """`residual` and its exact derivatives."""
    T_i_j = se3.inverse(T_w_i @ T_p_a) @ (T_w_j @ T_p_a)
    r = residual(T_j_i, T_w_i, T_w_j, T_p_a)
    J = se3.right_jacobian_inverse(r)
    to_assistant = se3.adjoint(se3.inverse(T_p_a))
    J_move = J @ se3.adjoint(T_i_j)
    return Linearised(r, J @ to_assistant, -J_move @ to_assistant, np.asarray(J - J_move))
