"""Cost function of the joint graph (paper IV-C): measurements, state, kernels, residuals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.posegraph import assistant_factor
from calm_edge.types import Float, Int

# Robust kernel: from whitened norms (P,) of loop residuals to (cost, weight), each (P,).
Kernel = Callable[[Float], tuple[Float, Float]]

# Edges whose residuals are computed at once: bounds the memory of the temporaries.
_CHUNK = 4096


class State(NamedTuple):
    """Unknowns: primary keyframe poses T_w_p (N, 4, 4) and rig T_p_a (4, 4), world units."""

    T_w_p: Float
    T_p_a: Float


@dataclass(frozen=True, slots=True)
class Edges:
    """Relative pose measurements between pairs of keyframes.

    i, j: (P,) rows of the state. T_j_i: (P, 4, 4) of the primary, world units.
    T_j_i_assistant: (P, 4, 4) of the assistant, arbitrary where its weight is 0.
    weight, weight_assistant: (P,) factors on the inverse variances, 0 for no measurement.
    robust: (P,) true for loop closures, to which the robust kernel applies.
    submap: (P,) running number of the sub-map that measured it, -1 for bridges and loops.
    """

    i: Int
    j: Int
    T_j_i: Float
    T_j_i_assistant: Float
    weight: Float
    weight_assistant: Float
    robust: NDArray[np.bool_]
    submap: Int

    def chosen(self, which: NDArray[np.bool_]) -> Edges:
        """Subset of the edges for which the mask `which` (P,) is true."""
        return Edges(**{name: getattr(self, name)[which] for name in Edges.__slots__})


def joined(edges: Sequence[Edges]) -> Edges:
    """Concatenate several Edges; raises ValueError for an empty sequence."""
    names = Edges.__slots__
    return Edges(**{name: np.concatenate([getattr(e, name) for e in edges]) for name in names})


@dataclass(frozen=True, slots=True)
class Problem:
    """Edges, rig prior and noise.

    T_p_a_prior: (4, 4). sigma, sigma_prior: (6,) of (translation, rotation) of edges and prior,
    world units and rad. spacing: world units per map unit. scale_sigma: sigma of a sub-map's log
    scale, from the scatter of its camera spacings. drawn: (S, 2) factors by which each sub-map's
    differences of translations and of rotations from the previous one were shrunk (`Submap.drawn`).
    """

    edges: Edges
    T_p_a_prior: Float
    sigma: Float
    sigma_prior: Float
    spacing: float
    scale_sigma: float
    drawn: Float


class Residuals(NamedTuple):
    """Unweighted residual twists: primary and assistant (P, 6) of each edge, rig prior (6,)."""

    primary: Float
    assistant: Float
    prior: Float


def huber(norm: Float, k: float = 3.0) -> tuple[Float, Float]:
    """Huber's kernel: convex, so a loop with a large residual still pulls, with bounded force.

    k: norm above which the cost is linear.
    """
    far = norm > k
    safe = np.where(far, norm, 1.0)
    return np.where(far, k * norm - k * k / 2, norm**2 / 2), np.where(far, k / safe, 1.0)


def cauchy(norm: Float, k: float = 3.0) -> tuple[Float, Float]:
    """Cauchy kernel: the weight of a loop with a large residual tends to zero.

    k: norm at which the weight is a half.
    """
    return k * k / 2 * np.log1p((norm / k) ** 2), 1 / (1 + (norm / k) ** 2)


def residuals(problem: Problem, state: State) -> Residuals:
    """Residuals of E_pri and E_loop, E_ast, and E_prior of IV-C at a state."""
    edges, (T_w_p, T_p_a) = problem.edges, state
    T_w_a = T_w_p @ T_p_a
    return Residuals(
        _relative(edges.T_j_i, T_w_p, edges),
        _relative(edges.T_j_i_assistant, T_w_a, edges),
        se3.log(se3.inverse(problem.T_p_a_prior) @ T_p_a),
    )


def _relative(T_j_i: Float, T_w_c: Float, edges: Edges) -> Float:
    """Residuals (P, 6) of one camera with poses T_w_c (N, 4, 4)."""
    r = np.empty((len(edges.i), 6))
    for start in range(0, len(r), _CHUNK):
        some = slice(start, start + _CHUNK)
        i, j = T_w_c[edges.i[some]], T_w_c[edges.j[some]]
        r[some] = assistant_factor.residual(T_j_i[some], i, j)
    return r


def norms(problem: Problem, r: Residuals) -> Float:
    """Whitened norms (P,) of the primary residuals, to which kernels are applied."""
    return np.asarray(
        np.linalg.norm(r.primary / problem.sigma, axis=-1) * np.sqrt(problem.edges.weight)
    )


def robust_weights(problem: Problem, r: Residuals, kernel: Kernel) -> Float:
    """Robust weights (P,) of the primary residuals: the kernel's for loops, 1 otherwise."""
    return np.where(problem.edges.robust, kernel(norms(problem, r))[1], 1.0)


def cost(problem: Problem, r: Residuals, kernel: Kernel) -> float:
    """Half the sum of squared Mahalanobis distances; loops pass through the kernel."""
    edges, norm = problem.edges, norms(problem, r)
    assistant = ((r.assistant / problem.sigma) ** 2).sum(-1) * edges.weight_assistant
    prior = ((r.prior / problem.sigma_prior) ** 2).sum()
    loops = kernel(norm[edges.robust])[0].sum()
    return float(loops + ((norm[~edges.robust] ** 2).sum() + assistant.sum() + prior) / 2)
