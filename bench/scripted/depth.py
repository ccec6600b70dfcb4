"""Depth that a model with a wrong K predicts: exact matches triangulated with its poses."""

from __future__ import annotations

import numpy as np

from bench.scripted import epipolar
from calm_edge.geometry import se3
from calm_edge.types import Float, Int

# Number of views with which each picture is triangulated.
_PARTNERS = 4
# Sigma of correspondences, px; and the relative depth error at which confidence is one half.
_MATCH_PX = 0.3
_HALF_CONFIDENT = 0.1


def partners(t_ns: Int) -> Int:
    """Indices (N, P), for each of N views, of the P others nearest in time, to triangulate with."""
    apart = np.abs(t_ns[:, None] - t_ns).astype(np.float64)
    np.fill_diagonal(apart, np.inf)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(_PARTNERS, len(t_ns) - 1)]


def triangulated(
    T_s_v: Float, x_v: Float, T_s_o: Float, x_o: Float, weight: Float, focal: float
) -> tuple[Float, Float]:
    """Triangulate z-depth (M,), 0 if unknown, and confidence (M,) along rays x_v (M, 3) of a view.

    T_s_v: (4, 4) pose of the view. T_s_o: (O, 4, 4) poses of O other views. x_o: (O, M, 3) their
    rays to the same points. weight: (O, M), 0 where a point is not visible. focal: of the view, px.
    """
    inverse, information = epipolar.inverse_depth(se3.inverse(T_s_o) @ T_s_v, x_v[None], x_o)
    information = information * weight
    total = information.sum(0)
    inverse = (information * inverse).sum(0) / np.maximum(total, 1e-18)
    known = (total > 0) & (inverse > 1e-6)
    depth = np.where(known, 1 / np.where(known, inverse, 1.0), 0.0)
    relative = _MATCH_PX / focal * depth / np.sqrt(np.maximum(total, 1e-18))
    return depth, np.where(known, 1 / (1 + (relative / _HALF_CONFIDENT) ** 2), 0.0)


def warp(at: Float, phases: Float) -> Float:
    """Smooth function with values (...) in [-1, 1], for the relative depth error in a picture.

    at: (..., 2) positions in the unit square. phases: (3,) rad.
    """
    x, y, z = phases
    return np.asarray(
        np.sin(2 * np.pi * at[..., 0] + x) * np.cos(np.pi * at[..., 1] + y) * np.sin(z)
    )
