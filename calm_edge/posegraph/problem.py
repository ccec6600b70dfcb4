"""What the joint graph minimises (paper IV-C), as arrays: measurements, state, kernels, cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.posegraph import assistant_factor
from calm_edge.types import Float, Int

# A kernel takes the whitened norms (P,) of loop residuals to (cost, weight), each (P,).
Kernel = Callable[[Float], tuple[Float, Float]]

# Pairs whose residuals are taken at once: their poses on the way are many times what they leave.
_CHUNK = 4096


class State(NamedTuple):
    """T_w_p (N, 4, 4) primary keyframes and T_p_a (4, 4), world units."""

    T_w_p: Float
    T_p_a: Float


@dataclass(frozen=True, slots=True)
class Edges:
    """Measurements between keyframes j and i, rows of the state (P,), world units.

    T_j_i: (P, 4, 4) of the primary. T_j_i_assistant: (P, 4, 4), anything where not weighed.
    weight, weight_assistant: (P,) factors on the inverse variances, 0 for none.
    robust: (P,) bool, whether the kernel applies (loop closures).
    submap: (P,) count of the sub-map that measured it, -1 for bridges and loops.
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
        """Those that `which` (P,) tells."""
        return Edges(**{name: getattr(self, name)[which] for name in Edges.__slots__})

    def shifted(self, rows: int) -> Edges:
        """The same of a state that begins `rows` later."""
        return replace(self, i=self.i + rows, j=self.j + rows)


def joined(edges: Sequence[Edges]) -> Edges:
    """One after the other; at least one."""
    names = Edges.__slots__
    return Edges(**{name: np.concatenate([getattr(e, name) for e in edges]) for name in names})


@dataclass(frozen=True, slots=True)
class Problem:
    """Edges, the prior on T_p_a, sigmas (6,) of (translation, rotation): world units, rad.

    spacing: world units a map unit. scale_sigma: one sigma of a sub-map's log scale, as the
    scatter of its spacing tells.
    """

    edges: Edges
    T_p_a_prior: Float
    sigma: Float
    sigma_prior: Float
    spacing: float
    scale_sigma: float


class Residuals(NamedTuple):
    """Twists, unweighted: primary and assistant (P, 6) of every edge, prior (6,) of T_p_a."""

    primary: Float
    assistant: Float
    prior: Float


def huber(norm: Float, k: float = 3.0) -> tuple[Float, Float]:
    """Convex: a long drift's true loop still pulls, and a false one only so hard."""
    far = norm > k
    safe = np.where(far, norm, 1.0)
    return np.where(far, k * norm - k * k / 2, norm**2 / 2), np.where(far, k / safe, 1.0)


def cauchy(norm: Float, k: float = 3.0) -> tuple[Float, Float]:
    """Lets go of a loop that the rest still contradicts."""
    return k * k / 2 * np.log1p((norm / k) ** 2), 1 / (1 + (norm / k) ** 2)


def residuals(problem: Problem, state: State) -> Residuals:
    """E_pri or E_loop, E_ast and E_prior of IV-C at a state."""
    edges, (T_w_p, T_p_a) = problem.edges, state
    T_w_a = T_w_p @ T_p_a
    return Residuals(
        _relative(edges.T_j_i, T_w_p, edges),
        _relative(edges.T_j_i_assistant, T_w_a, edges),
        se3.log(se3.inverse(problem.T_p_a_prior) @ T_p_a),
    )


def _relative(T_j_i: Float, T_w_c: Float, edges: Edges) -> Float:
    """(P, 6) of one camera, poses (N, 4, 4)."""
    r = np.empty((len(edges.i), 6))
    for start in range(0, len(r), _CHUNK):
        some = slice(start, start + _CHUNK)
        i, j = T_w_c[edges.i[some]], T_w_c[edges.j[some]]
        r[some] = assistant_factor.residual(T_j_i[some], i, j)
    return r


def norms(problem: Problem, r: Residuals) -> Float:
    """(P,) whitened lengths of the primary residuals: what a kernel takes."""
    return np.asarray(
        np.linalg.norm(r.primary / problem.sigma, axis=-1) * np.sqrt(problem.edges.weight)
    )


def softening(problem: Problem, r: Residuals, kernel: Kernel) -> Float:
    """(P,) factors on the primary's inverse variances: the kernel's of loops, else 1."""
    return np.where(problem.edges.robust, kernel(norms(problem, r))[1], 1.0)


def cost(problem: Problem, r: Residuals, kernel: Kernel) -> float:
    """Half the sum of squared Mahalanobis distances, loops through the kernel."""
    edges, norm = problem.edges, norms(problem, r)
    assistant = ((r.assistant / problem.sigma) ** 2).sum(-1) * edges.weight_assistant
    prior = ((r.prior / problem.sigma_prior) ** 2).sum()
    loops = kernel(norm[edges.robust])[0].sum()
    return float(loops + ((norm[~edges.robust] ** 2).sum() + assistant.sum() + prior) / 2)
