"""Joint optimum of the pose graph, with rejection of false loop closures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calm_edge.posegraph.levenberg_marquardt import minimise
from calm_edge.posegraph.loop_gate import accepted_loops
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
# Relative decrease of the cost at which the first pass, with the convex kernel, stops.
_COARSE = 1e-3
# Maximum number of rounds of loop selection: once loops are closed, more may be accepted.
_ROUNDS = 4
# Whitened norm at which the Cauchy kernel halves a loop's weight.
_HALF_WEIGHT = 3.0


@dataclass(frozen=True, slots=True)
class Optimum:
    """Result of an optimisation.

    loops: (R,) whether each loop was accepted, in the order they were added.
    """

    state: State
    loops: NDArray[np.bool_]


def optimum(problem: Problem, start: State, tolerance: float = TOLERANCE) -> Optimum:
    """Select loops and minimise the cost from `start`, the first keyframe held fixed.

    tolerance: relative decrease of the cost at which the iteration stops.
    """
    edges = problem.edges
    noise = measured_noise(problem) or assumed_noise(problem)
    loops = np.zeros(int(edges.robust.sum()), bool)
    state = start
    for count in range(_ROUNDS):
        more = loops | accepted_loops(problem, state.T_w_p, noise)
        if count and (more == loops).all():
            break
        loops = more
        state = _descend(_with_loops(problem, loops), state, tolerance)
    return Optimum(state, loops)


def _with_loops(problem: Problem, loops: NDArray[np.bool_]) -> Problem:
    """The problem with only those loops for which `loops` (R,) is true."""
    kept = ~problem.edges.robust
    kept[problem.edges.robust] = loops
    return replace(problem, edges=problem.edges.chosen(kept))


def _descend(problem: Problem, start: State, tolerance: float) -> State:
    """Local minimum from `start`.

    If the Cauchy kernel has rejected a loop, minimise again from a first pass with the convex
    Huber kernel, which closes a true loop over any drift. The result with the lower cost is
    returned: a false loop bends the trajectory and costs more.
    """
    state = minimise(problem, start, cauchy, tolerance)
    r = residuals(problem, state)
    if (norms(problem, r)[problem.edges.robust] < _HALF_WEIGHT).all():
        return state
    pulled = minimise(problem, start, huber, _COARSE)
    pulled = minimise(problem, pulled, cauchy, tolerance)
    if cost(problem, residuals(problem, pulled), cauchy) < cost(problem, r, cauchy):
        return pulled
    return state
