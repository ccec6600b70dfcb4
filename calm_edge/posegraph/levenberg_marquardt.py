"""Levenberg-Marquardt over primary poses and T_p_a (paper IV-C)."""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.posegraph.linear_system import Layout, LinearSystem
from calm_edge.posegraph.problem import Kernel, Problem, State, cost, residuals

MAX_ITERATIONS = 50
_FIRST_DAMPING = 1e-11
_MAX_DAMPING = 1e6
_STEP_TOLERANCE = 1e-9


def minimise(problem: Problem, state: State, kernel: Kernel, tolerance: float) -> State:
    """Minimise the cost from `state`, keyframe 0 fixed.

    tolerance: relative decrease of the cost at which the iteration stops.
    """
    r = residuals(problem, state)
    current = cost(problem, r, kernel)
    damping = least = _FIRST_DAMPING
    layout = Layout(problem.edges, len(state.T_w_p))
    for _ in range(MAX_ITERATIONS):
        linear = LinearSystem(problem, state, r, kernel, layout)
        while True:
            steps = linear.solve(damping)
            if steps is None and damping < _MAX_DAMPING:
                # rounding made the system indefinite: keep the damping above this value from now on
                damping = least = 10 * damping
                continue
            if steps is None:
                return state
            if np.abs(steps).max() < _STEP_TOLERANCE:
                return state
            candidate = State(state.T_w_p @ se3.exp(steps[:-1]), state.T_p_a @ se3.exp(steps[-1]))
            r_new = residuals(problem, candidate)
            new = cost(problem, r_new, kernel)
            if new <= current:
                break
            damping *= 10
            if damping > _MAX_DAMPING:
                return state
        done = current - new <= tolerance * current
        state, r, current = candidate, r_new, new
        damping = max(damping / 10, least)
        if done:
            return state
    return state
