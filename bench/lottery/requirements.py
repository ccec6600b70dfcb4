"""What is asked of the drives of the lottery, and what they give."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.normalised import (
    MAX_BEYOND_3_PERCENT,
    NOT_REPORTED,
    RMS,
    Normalised,
    normalised,
)
from bench.outcome import Outcome
from bench.tables import Check

TURNING_DEG, STRAIGHT_DEG = 15.0, 2.0


@dataclass(frozen=True, slots=True)
class Limits:
    """What is asked of a kind of drives, %.

    garbage: most of the steps. placed: least of the keyframes. called: least of the focals with
    more than TURNING_DEG. rms: range of error over sigma, beyond_3: most errors beyond three.
    scale, ate, worst: where the focals are observed, largest median error of the scale, median and
    worst ATE. ate_of_all: largest median ATE of all drives, None if not asked.
    """

    garbage: float = 0.1
    placed: float = 98
    called: float = 90
    rms: tuple[float, float] = RMS
    beyond_3: float = MAX_BEYOND_3_PERCENT
    scale: float = 1.0
    ate: float = 0.4
    worst: float = 1.5
    ate_of_all: float | None = 0.8


LIMITS = {
    "plain": Limits(),
    "real": Limits(0.5, 95, 80, (0.7, 1.4), 2.0, 1.5, 0.6, 3.0, None),
}


def requirements(found: Sequence[Outcome], asked: Limits) -> tuple[Check, ...]:
    """Every requirement on the drives, in the order of their importance."""
    observed = [one for one in found if all(one.observed)]
    return (
        *_keyframes(found, asked),
        _called_observed(found, asked.called),
        _never_observed(found),
        *observed_focals(found).checks(asked.rms, asked.beyond_3),
        *scales(found).checks(asked.rms, asked.beyond_3),
        _most(
            "focals observed: median error of the scale, %",
            asked.scale,
            _median(_scale(observed)),
        ),
        _most("focals observed: median ATE, %", asked.ate, _median(_ate(observed))),
        _most("focals observed: worst ATE, %", asked.worst, max(_ate(observed), default=None)),
        *_of_all(found, asked),
    )


def _of_all(found: Sequence[Outcome], asked: Limits) -> tuple[Check, ...]:
    if asked.ate_of_all is None:
        return ()
    return (_most("all drives: median ATE, %", asked.ate_of_all, _median(_ate(found))),)


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


def _keyframes(found: Sequence[Outcome], asked: Limits) -> tuple[Check, ...]:
    garbage = 100 * float(np.mean([one.garbage for one in found]))
    of_metric = 100 * float(np.mean([one.garbage_of_metric for one in found]))
    placed = 100 * float(np.mean([one.placed for one in found]))
    return (
        _most("garbage steps, of keyframes not said to be lost, %", asked.garbage, garbage),
        _most("garbage steps, of sub-maps that claim a metre, %", asked.garbage, of_metric),
        Check(
            "keyframes neither lost nor bridged, %",
            f">= {asked.placed:g}",
            placed,
            placed >= asked.placed,
        ),
    )


def _called_observed(found: Sequence[Outcome], least: float) -> Check:
    seen = [eye for one in found if one.yaw_deg > TURNING_DEG for eye in one.observed]
    what = f"focals called observed with more than {TURNING_DEG:g} degrees of yaw, %"
    if not seen:
        return Check(what, f">= {least:g}", "no such drive", True)
    share = 100 * float(np.mean(seen))
    return Check(what, f">= {least:g}", f"{share:.0f} of {len(seen)}", share >= least)


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
