"""The pose graph's residuals and their exact derivatives, all of them in one pass (paper IV-C).

Poses move on the right, T <- T exp(d), twists ordered (translation, rotation). E_pri and E_loop
are the same residual of a camera mounted at the identity: `between` is what all of them share.
"""

from __future__ import annotations

from typing import NamedTuple

from calm_edge.geometry import se3
from calm_edge.types import Float


class Between(NamedTuple):
    """Derivatives (P, 6, 6) of `residual` by the camera poses i and j."""

    by_i: Float
    by_j: Float


class Coupled(NamedTuple):
    """Derivatives (P, 6, 6) by the primary poses i and j and by T_p_a."""

    by_i: Float
    by_j: Float
    by_rig: Float


def residual(T_j_i: Float, T_w_i: Float, T_w_j: Float) -> Float:
    """log((T_j_i)^-1 T_w_j^-1 T_w_i), unweighted (P, 6); T_j_i as measured, all (P, 4, 4)."""
    return se3.log(se3.inverse(T_w_j @ T_j_i) @ T_w_i)


def between(r: Float, T_w_i: Float, T_w_j: Float) -> Between:
    """Exact derivatives of residuals r (P, 6) of one camera: E_pri and E_loop of IV-C."""
    by_i = se3.right_jacobian_inverse(r)
    return Between(by_i, -by_i @ se3.adjoint(se3.inverse(T_w_i) @ T_w_j))


def coupled(r: Float, T_w_i: Float, T_w_j: Float, T_p_a: Float) -> Coupled:
    """E_ast of IV-C: r (P, 6) of the assistant, T_w_i and T_w_j of the primary, T_p_a (4, 4)."""
    by_a_i, by_a_j = between(r, T_w_i @ T_p_a, T_w_j @ T_p_a)
    to_assistant = se3.adjoint(se3.inverse(T_p_a))
    return Coupled(by_a_i @ to_assistant, by_a_j @ to_assistant, by_a_i + by_a_j)
