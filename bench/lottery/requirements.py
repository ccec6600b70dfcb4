"""What is asked of the drives of the lottery, and what they give."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from bench.normalised import NOT_REPORTED, Normalised, normalised
from bench.outcome import Outcome
from bench.tables import Check

TURNING_DEG, STRAIGHT_DEG = 15.0, 2.0


def requirements(found: Sequence[Outcome]) -> tuple[Check, ...]:
    """Every requirement on the drives, in the order of their importance."""
    observed = [one for one in found if all(one.observed)]
    return (
        *_keyframes(found),
        _called_observed(found),
        _never_observed(found),
        *observed_focals(found).checks(),
        *scales(found).checks(),
        _most("focals observed: median error of the scale, %", 1.0, _median(_scale(observed))),
        _most("focals observed: median ATE, %", 0.4, _median(_ate(observed))),
        _most("focals observed: worst ATE, %", 1.5, max(_ate(observed), default=None)),
        _most("all drives: median ATE, %", 0.8, _median(_ate(found))),
    )


def observed_focals(found: Sequence[Outcome]) -> Normalised:
    """Log focals, each eye for itself, of those that are called observed."""
    pairs = [
        pair
        for one in found
        for seen, *pair in zip(
            one.observed, one.focal_error or (), one.focal_sigma or (), strict=False
        )
        if seen
    ]
    errors, sigmas = np.array(pairs).reshape(-1, 2).T
    return normalised("observed focals", errors, sigmas)


def scales(found: Sequence[Outcome]) -> Normalised:
    """Log scales of the drives with a result; those without a sigma are not reported."""
    known = [one for one in found if one.scale_error is not None]
    sigmas = [math.inf if one.scale_sigma is None else one.scale_sigma for one in known]
    return normalised("scale of a drive", [one.scale_error or 0.0 for one in known], sigmas)


def _keyframes(found: Sequence[Outcome]) -> tuple[Check, ...]:
    garbage = 100 * float(np.mean([one.garbage for one in found]))
    placed = 100 * float(np.mean([one.placed for one in found]))
    return (
        _most("garbage steps, of keyframes not said to be lost, %", 0.1, garbage),
        Check("keyframes neither lost nor bridged, %", ">= 98", placed, placed >= 98),
    )


def _called_observed(found: Sequence[Outcome]) -> Check:
    seen = [eye for one in found if one.yaw_deg > TURNING_DEG for eye in one.observed]
    what = f"focals called observed with more than {TURNING_DEG:g} degrees of yaw, %"
    if not seen:
        return Check(what, ">= 90", "no such drive", True)
    share = 100 * float(np.mean(seen))
    return Check(what, ">= 90", f"{share:.0f} of {len(seen)}", share >= 90)


def _never_observed(found: Sequence[Outcome]) -> Check:
    seen = [eye for one in found if one.yaw_deg < STRAIGHT_DEG for eye in one.observed]
    what = f"focals called observed with less than {STRAIGHT_DEG:g} degrees and no hint"
    return Check(what, "never", f"{sum(seen)} of {len(seen)}", not any(seen))


def _most(what: str, most: float, value: float | None) -> Check:
    if value is None:
        return Check(what, f"<= {most:g}", NOT_REPORTED, False)
    return Check(what, f"<= {most:g}", value, value <= most)


def _ate(found: Sequence[Outcome]) -> list[float]:
    """ATE of each drive, percent of the path; infinite without a result."""
    return [math.inf if one.ate_percent is None else one.ate_percent for one in found]


def _scale(found: Sequence[Outcome]) -> list[float]:
    return [100 * abs(one.scale_error) for one in found if one.scale_error is not None]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None
