"""Residuals of the pose graph and their exact derivatives, vectorised over edges (paper IV-C).

Perturbation on the right, T <- T exp(d), twists ordered (translation, rotation). E_ast is the cost
of the assistant's relative poses; that of the primary's, E_pri, and of loop closures, E_loop, is
the same with T_p_a = I; GTSAM calls this residual a BetweenFactor.
"""

from __future__ import annotations

from typing import NamedTuple

from calm_edge.geometry import se3
from calm_edge.types import Float


class Between(NamedTuple):
    """Derivatives (P, 6, 6) of `residual` with respect to poses i and j of the same camera."""

    by_i: Float
    by_j: Float


class Coupled(NamedTuple):
    """Derivatives (P, 6, 6) of the assistant's residuals by primary poses i and j and by T_p_a."""

    by_i: Float
    by_j: Float
    by_rig: Float


def residual(T_j_i: Float, T_w_i: Float, T_w_j: Float) -> Float:
    """Relative-pose residual log(T_j_i^-1 T_w_j^-1 T_w_i), (P, 6), unweighted.

    T_j_i: (P, 4, 4) measurement. T_w_i, T_w_j: (P, 4, 4) current poses.
    """
    return se3.log(se3.inverse(T_w_j @ T_j_i) @ T_w_i)


def between(r: Float, T_w_i: Float, T_w_j: Float) -> Between:
    """Derivatives of residuals r (P, 6) by the two poses of one camera: E_pri, E_loop of IV-C."""
    by_i = se3.right_jacobian_inverse(r)
    return Between(by_i, -by_i @ se3.adjoint(se3.inverse(T_w_i) @ T_w_j))


def coupled(r: Float, T_w_i: Float, T_w_j: Float, T_p_a: Float) -> Coupled:
    """Derivatives of the assistant's residuals r (P, 6), E_ast of IV-C.

    T_w_i, T_w_j: (P, 4, 4) primary poses; the assistant's are T_w_i T_p_a. T_p_a: (4, 4).
    """
    by_a_i, by_a_j = between(r, T_w_i @ T_p_a, T_w_j @ T_p_a)
    to_assistant = se3.adjoint(se3.inverse(T_p_a))
    return Coupled(by_a_i @ to_assistant, by_a_j @ to_assistant, by_a_i + by_a_j)
