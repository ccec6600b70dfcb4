"""Levenberg-Marquardt over primary poses and T_p_a; GTSAM eliminates (paper IV-C).

Every residual is linearised exactly in one numpy pass and handed to GTSAM as one factor a pair
of keyframes, with numpy's own tangent, so that GTSAM's order of rotation and translation never
enters. A Python-side nonlinear factor would cost a call a factor an iteration instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.posegraph import assistant_factor
from calm_edge.types import Float, Int

MAX_ITERATIONS = 50
_FIRST_DAMPING = 1e-11
_MAX_DAMPING = 1e6
_STEP_TOLERANCE = 1e-9

# A kernel takes the whitened norms (P,) of loop residuals to (cost, weight), each (P,).
Kernel = Callable[[Float], tuple[Float, Float]]


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
    """

    i: Int
    j: Int
    T_j_i: Float
    T_j_i_assistant: Float
    weight: Float
    weight_assistant: Float
    robust: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Problem:
    """Edges, the prior on T_p_a, sigmas (6,) of (translation, rotation): world units, rad."""

    edges: Edges
    T_p_a_prior: Float
    sigma: Float
    sigma_prior: Float


def huber(norm: Float, k: float = 3.0) -> tuple[Float, Float]:
    """Convex: a long drift's true loop still pulls, and a false one only so hard."""
    far = norm > k
    safe = np.where(far, norm, 1.0)
    return np.where(far, k * norm - k * k / 2, norm**2 / 2), np.where(far, k / safe, 1.0)


def cauchy(norm: Float, k: float = 3.0) -> tuple[Float, Float]:
    """Lets go of a loop that the rest still contradicts."""
    return k * k / 2 * np.log1p((norm / k) ** 2), 1 / (1 + (norm / k) ** 2)


def cost(problem: Problem, state: State, kernel: Kernel) -> float:
    """Half the sum of squared Mahalanobis distances, loops through the kernel."""
    edges, (T_w_p, T_p_a) = problem.edges, state
    i, j = T_w_p[edges.i], T_w_p[edges.j]
    primary = assistant_factor.residual(edges.T_j_i, i, j) / problem.sigma
    a_i, a_j = i @ T_p_a, j @ T_p_a
    assistant = assistant_factor.residual(edges.T_j_i_assistant, a_i, a_j) / problem.sigma
    prior = se3.log(se3.inverse(problem.T_p_a_prior) @ T_p_a) / problem.sigma_prior
    squared = (primary**2).sum(-1) * edges.weight
    loops = kernel(np.sqrt(squared[edges.robust]))[0].sum()
    total = squared[~edges.robust].sum() + ((assistant**2).sum(-1) * edges.weight_assistant).sum()
    return float(loops + (total + (prior**2).sum()) / 2)


def minimise(problem: Problem, state: State, kernel: Kernel, tolerance: float) -> tuple[State, int]:
    """The state of least cost near `state`, keyframe 0 held, and the iterations it took.

    tolerance: it ends when an iteration lowers the cost by less than this share.
    """
    current = cost(problem, state, kernel)
    damping = _FIRST_DAMPING
    ordering = None
    for iteration in range(1, MAX_ITERATIONS + 1):
        linear = _Linear(problem, state, kernel, ordering)
        ordering = linear.ordering
        while True:
            steps = linear.solve(damping)
            candidate = State(state.T_w_p @ se3.exp(steps[:-1]), state.T_p_a @ se3.exp(steps[-1]))
            if np.abs(steps).max() < _STEP_TOLERANCE:
                return state, iteration
            new = cost(problem, candidate, kernel)
            if new <= current:
                break
            damping *= 10
            if damping > _MAX_DAMPING:
                return state, iteration
        done = current - new <= tolerance * current
        state, current = candidate, new
        damping = max(damping / 10, _FIRST_DAMPING)
        if done:
            return state, iteration
    return state, MAX_ITERATIONS


class _Linear:
    """The linearised problem as a GTSAM graph: keys are rows of the state, T_p_a the last."""

    def __init__(
        self, problem: Problem, state: State, kernel: Kernel, ordering: Any = None
    ) -> None:
        import gtsam

        self._gtsam: Any = gtsam
        self._n = len(state.T_w_p)
        self._graph = gtsam.GaussianFactorGraph()
        self._add_edges(problem, state, kernel)
        r = se3.log(se3.inverse(problem.T_p_a_prior) @ state.T_p_a)
        J = se3.right_jacobian_inverse(r) / problem.sigma_prior[:, None]
        unit = gtsam.noiseModel.Unit.Create(6)
        self._graph.add(gtsam.JacobianFactor(self._n, J, -r / problem.sigma_prior, unit))
        # the gauge: without it the whole world may move at no cost, so any weight holds exactly
        self._graph.add(gtsam.JacobianFactor(0, np.eye(6) / problem.sigma, np.zeros(6), unit))
        # T_p_a touches every keyframe: eliminated last, the rest stays a narrow band
        self.ordering = ordering or gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(
            self._graph, [self._n]
        )

    def _add_edges(self, problem: Problem, state: State, kernel: Kernel) -> None:
        edges, sigma = problem.edges, problem.sigma
        i, j = state.T_w_p[edges.i], state.T_w_p[edges.j]
        primary = assistant_factor.between(edges.T_j_i, i, j)
        assistant = assistant_factor.linearise(edges.T_j_i_assistant, i, j, state.T_p_a)
        root = np.sqrt(edges.weight)
        norm = np.linalg.norm(primary.r / sigma, axis=-1) * root
        root = root * np.where(edges.robust, np.sqrt(kernel(norm)[1]), 1.0)
        rows_p = (root[:, None] / sigma)[..., None]
        rows_a = (np.sqrt(edges.weight_assistant)[:, None] / sigma)[..., None]
        A_i = np.concatenate([primary.by_i * rows_p, assistant.by_i * rows_a], 1)
        A_j = np.concatenate([primary.by_j * rows_p, assistant.by_j * rows_a], 1)
        A_rig = np.concatenate([np.zeros_like(primary.by_i), assistant.by_rig * rows_a], 1)
        b = -np.concatenate([primary.r * rows_p[..., 0], assistant.r * rows_a[..., 0]], 1)
        factor, unit = self._gtsam.JacobianFactor, self._gtsam.noiseModel.Unit.Create(12)
        for p, (key_i, key_j) in enumerate(zip(edges.i.tolist(), edges.j.tolist(), strict=True)):
            self._graph.add(factor(key_i, A_i[p], key_j, A_j[p], self._n, A_rig[p], b[p], unit))

    def solve(self, damping: float) -> Float:
        """Steps (N + 1, 6) of the damped normal equations."""
        damped = self._gtsam.GaussianFactorGraph()
        damped.push_back(self._graph)
        root, zero = np.sqrt(damping) * np.eye(6), np.zeros(6)
        unit = self._gtsam.noiseModel.Unit.Create(6)
        for key in range(self._n + 1):
            damped.add(self._gtsam.JacobianFactor(key, root, zero, unit))
        solution = damped.optimize(self.ordering)
        return np.stack([solution.at(key) for key in range(self._n + 1)])
