"""Semi-global matching: aggregation of a cost volume along rows and columns."""

from __future__ import annotations

import numpy as np

from calm_edge.types import Bytes, Float32

# Cost of a step of depth between two pixels, by one plane (P1 of the publication) and by more (P2);
# P2 is divided by 1 + their difference of grey levels / EDGE_LEVELS.
STEP_COST = 0.1
JUMP_COST = 0.8
EDGE_LEVELS = 12.0


def aggregate(cost: Float32, gray: Bytes) -> Float32:
    """(D, h, w) costs -> the mean of four semi-global path costs, the same shape.

    gray: (h, w), the picture of the volume. Hirschmueller, PAMI 2008: C is `cost`; along each path
    (rightwards, leftwards, down, up), with q the pixel before p, and d, k planes,
    L(p, d) = C(p, d) + min(L(q, d), L(q, d +- 1) + step, min_k L(q, k) + jump) - min_k L(q, k).
    """
    total = np.zeros_like(cost)
    for axis in (1, 2):
        lines = np.ascontiguousarray(np.moveaxis(cost, axis, 0))
        edge = np.abs(np.diff(gray.astype(np.float32), axis=axis - 1)) / np.float32(EDGE_LEVELS)
        jump = np.float32(JUMP_COST) / (1 + np.moveaxis(edge, axis - 1, 0))
        total += np.moveaxis(_both_ways(lines, np.maximum(jump, 2 * STEP_COST)), 0, axis)
    total *= np.float32(0.25)
    return total


def _both_ways(lines: Float32, jump: Float32) -> Float32:
    """Sum of the forward and backward path costs of m lines of n pixels, at D planes: (n, D, m).

    lines: (n, D, m) costs. jump: (n - 1, m) cost of a jump between successive pixels.
    """
    n, planes, m = lines.shape
    step = np.float32(STEP_COST)
    out = np.zeros_like(lines)
    path = np.empty((planes, 2, m), np.float32)
    path[:, 0], path[:, 1] = lines[0], lines[-1]
    out[0] += path[:, 0]
    out[-1] += path[:, 1]
    best = np.empty_like(path)
    near = np.empty_like(path)
    limit = np.empty((2, m), np.float32)
    for i in range(1, n):
        floor = path.min(0)
        limit[0], limit[1] = jump[i - 1], jump[-i]
        limit += floor
        np.add(path, step, out=near)
        np.minimum(path, limit, out=best)
        np.minimum(best[1:], near[:-1], out=best[1:])
        np.minimum(best[:-1], near[1:], out=best[:-1])
        best -= floor
        best[:, 0] += lines[i]
        best[:, 1] += lines[-1 - i]
        out[i] += best[:, 0]
        out[-1 - i] += best[:, 1]
        path, best = best, path
    return out
