"""The pose graph's residuals and their exact derivatives, all of them in one pass (paper IV-C).

Poses move on the right, T <- T exp(d), twists ordered (translation, rotation). E_pri and E_loop
are the same residual of a camera mounted at the identity: `between` is what all of them share.
"""

from __future__ import annotations

from typing import NamedTuple

from calm_edge.geometry import se3
from calm_edge.types import Float


class Between(NamedTuple):
    """r (P, 6) and its derivatives (P, 6, 6) by the camera poses i and j."""

    r: Float
    by_i: Float
    by_j: Float


class Linearised(NamedTuple):
    """r (P, 6) and its derivatives (P, 6, 6) by the primary poses i and j and by T_p_a."""

    r: Float
    by_i: Float
    by_j: Float
    by_rig: Float


def residual(T_j_i: Float, T_w_i: Float, T_w_j: Float) -> Float:
    """log((T_j_i)^-1 T_w_j^-1 T_w_i), unweighted (P, 6); T_j_i as measured, all (P, 4, 4)."""
    return se3.log(se3.inverse(T_w_j @ T_j_i) @ T_w_i)


def between(T_j_i: Float, T_w_i: Float, T_w_j: Float) -> Between:
    """`residual` of one camera and its exact derivatives: E_pri and E_loop of IV-C."""
    r = residual(T_j_i, T_w_i, T_w_j)
    by_i = se3.right_jacobian_inverse(r)
    return Between(r, by_i, -by_i @ se3.adjoint(se3.inverse(T_w_i) @ T_w_j))


def linearise(T_j_i: Float, T_w_i: Float, T_w_j: Float, T_p_a: Float) -> Linearised:
    """E_ast of IV-C: T_j_i of the assistant, T_w_i and T_w_j of the primary, T_p_a (4, 4)."""
    r, by_a_i, by_a_j = between(T_j_i, T_w_i @ T_p_a, T_w_j @ T_p_a)
    to_assistant = se3.adjoint(se3.inverse(T_p_a))
    return Linearised(r, by_a_i @ to_assistant, by_a_j @ to_assistant, by_a_i + by_a_j)
