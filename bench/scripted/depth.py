"""Depth as a model with a wrong K and its poses triangulates it from what truly corresponds."""

from __future__ import annotations

import numpy as np

from bench.scripted import epipolar
from calm_edge.geometry import se3
from calm_edge.types import Float, Int

# How many views, nearest in time, each picture is compared with.
_PARTNERS = 4
# What a model's correspondences are worth, and the relative depth error it half believes.
_MATCH_PX = 0.3
_HALF_BELIEVED = 0.1


def partners(t_ns: Int) -> Int:
    """(N, P) other views nearest in time of each of N views."""
    apart = np.abs(t_ns[:, None] - t_ns).astype(np.float64)
    np.fill_diagonal(apart, np.inf)
    return np.argsort(apart, axis=1, kind="stable")[:, : min(_PARTNERS, len(t_ns) - 1)]


def triangulated(
    T_s_v: Float, x_v: Float, T_s_o: Float, x_o: Float, weight: Float, focal: float
) -> tuple[Float, Float]:
    """z-depth (M,) of rays x_v (M, 3) of a view, 0 unknown, and confidence (M,).

    T_s_v (4, 4), T_s_o (O, 4, 4): the model's poses of it and of O others. x_o: (O, M, 3) where
    those see the same points. weight: (O, M), 0 where they do not. focal: of the view, px.
    """
    inverse, information = epipolar.inverse_depth(se3.inverse(T_s_o) @ T_s_v, x_v[None], x_o)
    information = information * weight
    total = information.sum(0)
    inverse = (information * inverse).sum(0) / np.maximum(total, 1e-18)
    known = (total > 0) & (inverse > 1e-6)
    depth = np.where(known, 1 / np.where(known, inverse, 1.0), 0.0)
    relative = _MATCH_PX / focal * depth / np.sqrt(np.maximum(total, 1e-18))
    return depth, np.where(known, 1 / (1 + (relative / _HALF_BELIEVED) ** 2), 0.0)


def warp(at: Float, phases: Float) -> Float:
    """(...) smooth values in [-1, 1] at places (..., 2) of the unit picture, by phases (3,)."""
    x, y, z = phases
    return np.asarray(
        np.sin(2 * np.pi * at[..., 0] + x) * np.cos(np.pi * at[..., 1] + y) * np.sin(z)
    )
