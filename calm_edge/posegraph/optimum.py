"""The joint optimum, loops told apart on the way: a pure function, fit for another process."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calm_edge.posegraph.levenberg_marquardt import minimise
from calm_edge.posegraph.loop_gate import believed
from calm_edge.posegraph.noise import assumed_noise, measured_noise
from calm_edge.posegraph.problem import (
    Problem,
    State,
    cauchy,
    cost,
    huber,
    norms,
    residuals,
)

TOLERANCE = 1e-6
# How far the convex pass goes: until it moves the cost by less than this share.
_COARSE = 1e-3
# A closed loop shows which others are true; each round may believe more of them.
_ROUNDS = 4
# A loop of this whitened length keeps half its weight under the Cauchy kernel.
_HALF_WEIGHT = 3.0


@dataclass(frozen=True, slots=True)
class Optimum:
    """State: where everything belongs. Costs: half squared Mahalanobis distances, of the
    measurements believed. loops: (R,) bool in the order they were added, which were believed.
    """

    state: State
    iterations: int
    cost_before: float
    cost_after: float
    loops: NDArray[np.bool_]


def optimum(problem: Problem, start: State, tolerance: float = TOLERANCE) -> Optimum:
    """The poses of least cost, the first keyframe held.

    tolerance: it ends when an iteration lowers the cost by less than this share.
    """
    edges = problem.edges
    noise = measured_noise(problem) or assumed_noise(problem)
    loops = np.zeros(int(edges.robust.sum()), bool)
    state, iterations = start, 0
    kept = problem
    for count in range(_ROUNDS):
        more = loops | believed(problem, state.T_w_p, noise)
        if count and (more == loops).all():
            break
        loops, kept = more, _with_loops(problem, more)
        state, steps = _descend(kept, state, tolerance)
        iterations += steps
    return Optimum(
        state=state,
        iterations=iterations,
        cost_before=cost(kept, residuals(kept, start), cauchy),
        cost_after=cost(kept, residuals(kept, state), cauchy),
        loops=loops,
    )


def _with_loops(problem: Problem, loops: NDArray[np.bool_]) -> Problem:
    """The problem with some of its loops only."""
    kept = ~problem.edges.robust
    kept[problem.edges.robust] = loops
    return replace(problem, edges=problem.edges.chosen(kept))


def _descend(problem: Problem, start: State, tolerance: float) -> tuple[State, int]:
    """The optimum near `start` and the iterations it took.

    With loops there are two ways down: at once, and, where that left a loop out, after a convex
    kernel, by which a true loop closes however far the drift. The lower of the two ends is kept:
    a false loop bends the path at a cost.
    """
    state, iterations = minimise(problem, start, cauchy, tolerance)
    r = residuals(problem, state)
    if (norms(problem, r)[problem.edges.robust] < _HALF_WEIGHT).all():
        return state, iterations
    pulled, coarse = minimise(problem, start, huber, _COARSE)
    pulled, fine = minimise(problem, pulled, cauchy, tolerance)
    if cost(problem, residuals(problem, pulled), cauchy) < cost(problem, r, cauchy):
        state = pulled
    return state, iterations + coarse + fine
