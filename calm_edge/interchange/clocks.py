"""Relation of two cameras' clocks from their turns, with sound as a second witness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.interchange import InterchangeError
from calm_edge.interchange.clock_fit import ClockFit, fit
from calm_edge.interchange.clock_search import Coarse, search
from calm_edge.interchange.sound import SIGMA_S
from calm_edge.interchange.steadiness import Noise, stabilised, zoomed
from calm_edge.interchange.turn_rates import rates
from calm_edge.interchange.turns import Turns

SEARCH_DT_S, SEARCH_SMOOTH_S = 0.05, 0.1
FIT_DT_S, FIT_SMOOTH_S = 0.02, 0.05
# a fit farther than this from where it began has left the peak
LEFT_S = 1.0
# below this share, what both cameras show of turns is not the same motion
LEAST_EXPLAINED = 0.3


@dataclass(frozen=True, slots=True)
class Relation:
    """Fit of the clocks and what the sound says: its offset minus the fit's [s], or None."""

    fit: ClockFit
    sound_s: float | None

    def lines(self) -> list[str]:
        """What was found, for the user."""
        f = self.fit
        lines = [
            f"clock offset {f.offset_s:+.4f} s (add to the assistant's stamps), "
            f"sigma {1e3 * f.sigma_s:.1f} ms, by turns of both cameras over {f.span_s:.0f} s",
            f"clock drift {1e6 * f.drift:+.0f} ppm, sigma {1e6 * f.drift_sigma:.0f} ppm",
        ]
        if self.sound_s is not None:
            agrees = abs(self.sound_s) < 3 * np.hypot(SIGMA_S, f.sigma_s)
            verb = "agrees" if agrees else "disagrees; the motion is used"
            lines.append(f"sound: {verb} ({1e3 * self.sound_s:+.0f} ms)")
        return lines

    def facts(self) -> dict[str, str]:
        """The same as texts of numbers, for programs."""
        f = self.fit
        return {
            "clock_offset_s": repr(f.offset_s),
            "clock_offset_at_s": repr(f.at_s),
            "clock_offset_sigma_s": repr(f.sigma_s),
            "clock_drift": repr(f.drift),
            "clock_drift_sigma": repr(f.drift_sigma),
        }


def relate(primary: Turns, assistant: Turns, sound: Coarse | None) -> Relation:
    """Find the relation of the clocks; raises InterchangeError if the motion does not show it."""
    coarse = [rates(turns, SEARCH_DT_S, SEARCH_SMOOTH_S) for turns in (primary, assistant)]
    found = search(coarse[0], coarse[1])
    if found is None or not found.certain:
        if sound is None:
            raise InterchangeError(_unseen(found))
        found = sound
    fine = [rates(turns, FIT_DT_S, FIT_SMOOTH_S) for turns in (primary, assistant)]
    try:
        fitted = fit(fine[0], fine[1], found.offset_s, found.drift, found.at_s)
    except ValueError:
        raise InterchangeError(_unseen(found)) from None
    moved = fitted.at(found.at_s) - found.offset_s
    if abs(moved) > LEFT_S or fitted.explained < LEAST_EXPLAINED:
        raise InterchangeError(_unseen(found))
    apart = None if sound is None else sound.offset_s - fitted.at(sound.at_s)
    return Relation(fitted, apart)


def _unseen(found: Coarse | None) -> str:
    if found is None:
        reason = "one of them is too short or shows nothing that can be tracked"
    else:
        reason = f"their turns agree best at {found.offset_s:+.2f} s, but not clearly"
    return (
        f"the clocks of the two videos cannot be related: {reason}; give videos of one drive "
        "with turns or bumps in their common time, or the offset by --offset-s"
    )


def check_steady(relation: Relation, primary: Turns, assistant: Turns) -> None:
    """Refuse video whose camera changes from frame to frame; raises InterchangeError."""
    noises = [
        Noise(float(np.median(t.sigma[np.isfinite(t.sigma)])), float(np.median(np.diff(t.t_s))))
        for t in (primary, assistant)
    ]
    eye, ratio = stabilised(relation.fit, (noises[0], noises[1]), FIT_SMOOTH_S)
    if eye:
        other = "assistant" if eye == "primary" else "primary"
        raise InterchangeError(
            f"{eye}: shakes with {100 * ratio:.0f} % of the {other}'s power in the same turns, so "
            "its video is stabilised (or the other camera is loose), and no fixed camera describes "
            "it; record with stabilisation off, or accept it by --accept-unsteady"
        )
    zoom = zoomed(relation.fit)
    if zoom is not None:
        at, factor = zoom
        raise InterchangeError(
            f"assistant: turns {factor:.2f} times as far as the primary after {at:.0f} s, compared "
            "with before, so one of them was zoomed; cut the video there, or accept it by "
            "--accept-unsteady"
        )
