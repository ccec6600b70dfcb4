"""Time that passed, or was filmed twice, between the parts of a split video.

A recorder that begins a new file may lose a second, or repeat one. The other camera shows how much:
the clock offset is fitted to each stretch without a new part, and jumps where a part begins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.clock_fit import ClockFit, fit
from calm_edge.interchange.clocks import FIT_DT_S, FIT_SMOOTH_S, relate
from calm_edge.interchange.turn_rates import Rates, rates
from calm_edge.interchange.turns import Turns
from calm_edge.types import Float
from device.frame import Eye

# longest gap that is searched, and step of the search
LONGEST_S, SCAN_S = 3.0, 0.04
# a shorter stretch does not show its offset
LEAST_S = 6.0
LEAST_EXPLAINED = 0.3
# parts of a video that are compared to find a first offset
MOST_PARTS = 12
# a smaller jump may be the fit's error
LEAST_GAP_S, SIGMAS = 0.02, 4.0


@dataclass(frozen=True, slots=True)
class Gap:
    """Time [s] between the parts of an eye's video that the stamps lack; at_s: of the new part."""

    eye: Eye
    at_s: float
    gap_s: float
    sigma_s: float

    def line(self) -> str:
        """The gap, for the user."""
        what = "passed" if self.gap_s > 0 else "was filmed twice"
        return (
            f"{self.eye.name.lower()}: {abs(self.gap_s):.3f} s {what} before the part at "
            f"{self.at_s:.1f} s, sigma {1e3 * self.sigma_s:.0f} ms, by the other camera"
        )


def find_gaps(
    primary: Turns, assistant: Turns, joins_s: tuple[list[float], list[float]]
) -> list[Gap]:
    """Find the gaps at the joins of both videos, given as first stamps of the parts.

    Parts that show no offset of their own have none. Raises InterchangeError if no part does.
    """
    if not any(joins_s):
        return []
    anchor = _anchor(primary, assistant, joins_s)
    ends = [float(assistant.t_s[0]), float(assistant.t_s[-1])]
    joins = [(t, Eye.ASSISTANT, t) for t in joins_s[Eye.ASSISTANT]]
    joins += [(t - anchor.at(anchor.at_s), Eye.PRIMARY, t) for t in joins_s[Eye.PRIMARY]]
    joins = sorted(join for join in joins if ends[0] < join[0] < ends[1])
    bounds = [ends[0], *(t for t, _, _ in joins), ends[1]]
    fine = [rates(turns, FIT_DT_S, FIT_SMOOTH_S) for turns in (primary, assistant)]
    found: list[ClockFit | None] = [None] * (len(bounds) - 1)
    middle = int(np.clip(np.searchsorted(bounds, anchor.at_s) - 1, 0, len(found) - 1))
    for order in (range(middle, len(found)), range(middle - 1, -1, -1)):
        near = found[middle] or anchor
        for k in order:
            found[k] = _stretch(fine[0], fine[1], bounds[k], bounds[k + 1], near)
            near = found[k] or near
    gaps = []
    for (at, eye, own), before, after in zip(joins, found[:-1], found[1:], strict=True):
        if before is None or after is None:
            continue
        jump = after.at(at) - before.at(at)
        sigma = float(np.hypot(before.sigma_s, after.sigma_s))
        if abs(jump) > max(LEAST_GAP_S, SIGMAS * sigma):
            gaps.append(Gap(eye, own, jump if eye is Eye.ASSISTANT else -jump, sigma))
    return gaps


def shifted(t_s: Float, gaps: list[Gap], eye: Eye) -> Float:
    """Stamps (N,) of an eye with the gaps added."""
    return np.asarray(t_s + sum(g.gap_s * (t_s >= g.at_s - 1e-6) for g in gaps if g.eye is eye))


def increasing(t_s: Float) -> NDArray[np.bool_]:
    """Mask of stamps (N,) after all before: what was filmed twice is kept once."""
    before = np.r_[-np.inf, np.maximum.accumulate(t_s)[:-1]]
    return np.asarray(t_s > before)


def with_stamps(turns: Turns, t_s: Float) -> Turns:
    """Turns with other stamps (N,); pictures whose stamp does not increase are left out."""
    keep = np.flatnonzero(increasing(t_s))
    # a turn past pictures that are left out is unknown
    sigma = np.where(np.diff(keep) == 1, turns.sigma[keep[1:] - 1], np.inf)
    steps = keep[1:] - 1
    return Turns(t_s[keep], turns.step[steps], turns.zoom[steps], sigma)


def _anchor(primary: Turns, assistant: Turns, joins_s: tuple[list[float], list[float]]) -> ClockFit:
    """Fit of the part of the assistant's video that shows its offset best.

    Compared with all of the primary's; where gaps there leave no clear offset, with its parts.
    """
    parts = [_parts(t, joins) for t, joins in zip((primary, assistant), joins_s, strict=True)]
    best: ClockFit | None = None
    reason: InterchangeError | None = None
    for whole in ([primary], parts[Eye.PRIMARY][:MOST_PARTS]):
        for one, other in product(whole, parts[Eye.ASSISTANT][:MOST_PARTS]):
            try:
                found = relate(one, other, None).fit
            except InterchangeError as error:
                reason = error
                continue
            if best is None or found.sigma_s < best.sigma_s:
                best = found
        if best is not None:
            return best
    raise reason or InterchangeError(
        "the parts of the videos are too short to relate their clocks; give --offset-s"
    )


def _parts(turns: Turns, joins_s: list[float]) -> list[Turns]:
    """Turns of each part of at least LEAST_S, the longest first."""
    bounds = [0, *np.searchsorted(turns.t_s, joins_s).tolist(), len(turns.t_s)]
    found = [
        Turns(turns.t_s[i:j], turns.step[i : j - 1], turns.zoom[i : j - 1], turns.sigma[i : j - 1])
        for i, j in pairwise(bounds)
        if j - i > 2 and turns.t_s[j - 1] - turns.t_s[i] >= LEAST_S
    ]
    return sorted(found, key=lambda t: float(t.t_s[0] - t.t_s[-1]))


def _stretch(
    primary: Rates, assistant: Rates, start_s: float, end_s: float, near: ClockFit
) -> ClockFit | None:
    """Fit to a stretch of the assistant's time, searched about a neighbour's offset."""
    t = assistant.t_s
    # smoothing reaches over the joins, and those of the primary are known roughly
    inside = assistant.known & (t > start_s + 1.0) & (t < end_s - 1.0)
    if inside.sum() * assistant.dt_s < LEAST_S:
        return None
    rows = np.flatnonzero(inside)
    spline = CubicSpline(primary.t_s, primary.rate, axis=0)
    b = assistant.rate[rows][:, :2]
    scores = []
    for lag in np.arange(-LONGEST_S, LONGEST_S + SCAN_S / 2, SCAN_S):
        u = near.primary_time(t[rows]) + lag
        seen = (u > primary.start_s) & (u < primary.end_s)
        if seen.sum() * assistant.dt_s < LEAST_S:
            continue
        predicted = (spline(u[seen]) @ near.mixing.T)[:, :2]
        left = float(((b[seen] - predicted) ** 2).sum() / max((b[seen] ** 2).sum(), 1e-30))
        scores.append((left, float(lag)))
    if not scores:
        return None
    middle = float(t[rows].mean())
    part = replace(assistant, known=inside)
    try:
        found = fit(primary, part, near.at(middle) + min(scores)[1], near.drift, middle)
    except ValueError:
        return None
    return found if found.explained > LEAST_EXPLAINED else None
