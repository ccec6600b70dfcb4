"""Initial states of a window: several, compared by their cost after a few iterations.

A chain of resections can drift, and a wrong direction of travel, focal or spacing can trap the
solver, so no start is taken because it is the only one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import stamps, window
from calm_edge.backbones.bundle.initialise import (
    Poses,
    Rig,
    chained,
    driven,
    initial_state,
    triangulated,
)
from calm_edge.backbones.bundle.problem import Measurements, RigTies, State
from calm_edge.backbones.bundle.solver import PosePrior, solve
from calm_edge.geometry.fisheye import FieldTooWide
from calm_edge.kit import layout
from calm_edge.kit.lens import Family
from calm_edge.types import Float, KitBelief

# Factors on the prior's focals that are tried while their sigma exceeds FOCAL_OPEN, by the families
# of the lenses: those of fisheye lenses are at 110 and 140 degrees across.
FOCAL_GUESSES, FOCAL_OPEN = (1.0, 1.25, 0.75), 0.2
FISHEYE_GUESSES = (layout.WIDE_HFOV_DEG / 110.0, layout.WIDE_HFOV_DEG / 140.0)
# Other lenses than perspective ones are chosen only if their cost is below this share: they can
# imitate these, at less certainty.
OTHER_LENSES = 0.9
# Share of the window between the first pair of keyframes of each structure from motion.
SEED_SHARES = (0.5, 0.3, 0.15)
# Trials are solved with this many points and iterations, and scale of the Cauchy kernel [sigmas].
POINTS, ITERATIONS, ROBUST_SCALE = 200, 15, 2.0
# Two paths at least are tried, and no more after a robust cost per observation below this.
ENOUGH_PATHS, GOOD_START = 2, 1.0


@dataclass(frozen=True, slots=True)
class Known:
    """What is known of a window before it is solved.

    kits: priors, weighed against pixels, one for each pair of families that the lenses may be of,
    the first of perspective ones unless it is the only one. poses: further priors, also of the
    previous window. focal_sigma: of the log focals, the larger. rig: whether the prior's rotation
    of the rig is exact enough to start from, and all: whether its focals are too. travel: (3,)
    direction of travel, primary axes, or None. follows: whether `poses` holds the previous window.
    """

    kits: Sequence[KitBelief]
    poses: Sequence[PosePrior]
    focal_sigma: float
    rig: bool
    all: bool
    travel: Float | None = None
    follows: bool = False


def initial_states(m: Measurements, ties: RigTies, known: Known) -> Iterator[State]:
    """Initial states with all points, one after the other; raises BackboneError if there is none.

    After a solved window the first path alone comes first, for the caller to take if its solution
    agrees with that window, which is the usual case. All trials follow, the cheapest first.
    """
    few = window.thinned(m, POINTS)
    if known.follows and known.rig:
        with suppress(BackboneError, FieldTooWide):
            kit = known.kits[0]
            theta = kit.mean.copy()
            path = next(iter(driven(few, theta, known.travel)))
            start = initial_state(few, theta, Rig.KNOWN, path)
            state = _trial(few, ties, kit, known.poses, start)[1]
            yield _whole(m, state)
    for _, state in sorted(_trials(few, ties, known), key=_cost):
        yield _whole(m, state)


def _trials(few: Measurements, ties: RigTies, known: Known) -> list[tuple[float, State]]:
    tried: list[tuple[float, State]] = []
    failure = BackboneError("bundle: no initial solution from any pair of keyframes")
    # the rig is fitted to the window unless it is known; where only its rotation is, all are tried
    rigs = [Rig.KNOWN] if known.all else list(Rig) if known.rig else [Rig.FITTED, Rig.ABREAST]
    for kit, theta in _guesses(known):
        for count, path in enumerate(_paths(few, theta, known.travel), 1):
            for rig in rigs:
                try:
                    start = initial_state(few, theta, rig, path())
                    cost, state = _trial(few, ties, kit, known.poses, start)
                except BackboneError as error:
                    failure = error
                except FieldTooWide as error:
                    failure = BackboneError(f"bundle: {error}")
                else:
                    tried.append((cost if kit is known.kits[0] else cost / OTHER_LENSES, state))
            if count >= ENOUGH_PATHS and tried and min(tried, key=_cost)[0] < GOOD_START:
                break
    if not tried:
        raise failure
    return tried


def _guesses(known: Known) -> Iterator[tuple[KitBelief, Float]]:
    """Priors and kits to start from."""
    for kit in known.kits:
        families = layout.families(kit.mean)
        guesses = [np.zeros(2)]
        if known.focal_sigma > FOCAL_OPEN and families[0] is families[1]:
            wide = families[0] is Family.FISHEYE
            guesses = [np.log(g) for g in (FISHEYE_GUESSES if wide else FOCAL_GUESSES)]
        for guess in guesses:
            theta = kit.mean.copy()
            theta[layout.LOG_FOCAL] += guess
            yield kit, theta


def _whole(m: Measurements, state: State) -> State:
    """The state of a trial with all points of the window."""
    return replace(state, points=triangulated(m, state.T_c_s, state.theta))


def _cost(trial: tuple[float, State]) -> float:
    return trial[0]


def _paths(m: Measurements, theta: Float, travel: Float | None) -> list[Callable[[], Poses]]:
    """Ways to place the primary's views: as a car moves, then by structure from motion."""
    paths = list(driven(m, theta, travel))
    if travel is not None:
        paths += driven(m, theta, None)
    chains = [partial(chained, m, theta, share) for share in SEED_SHARES]
    return [*(partial(dict[int, Float], path) for path in paths), *chains]


def _trial(
    m: Measurements, ties: RigTies, kit: KitBelief, poses: Sequence[PosePrior], start: State
) -> tuple[float, State]:
    """Robust cost per observation, and state, after a few iterations; raises BackboneError."""
    found = solve(
        start, m, stamps.freed(ties, start), kit,
        pose_priors=poses, robust_scale=ROBUST_SCALE, max_iterations=ITERATIONS,
    )  # fmt: skip
    window.lenses(found.state, m)
    return found.cost / len(m.uv), found.state
