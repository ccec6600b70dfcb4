"""How well the lengths of a drive are known, given the spacing between the cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calm_edge.types import METRIC_LOG_SIGMA, Metre, Submap

# A car that has moved less than this many spacings in all windows stood still.
STANDSTILL_SPACINGS = 1.0
# A path that is no measurement and leads less far than this share of its length is noise.
STRAY = 0.5
# Largest sigma of the log scale that a sub-map counts with: then its length is no measurement.
UNKNOWN = 1.0

NO_WINDOW = "no window was solved"
STOOD = "the car stood still"
ALONE = "one window alone shows it so far: the next one has to agree"
NO_FOCAL = "the drive was too straight to show the focal lengths: drive a turn or give --hfov-deg"
NO_PARALLAX = "the cameras show too little parallax: nothing is near enough, or both see the same"


class DriveMetre:
    """Metre of a drive from its sub-maps, and objections to it from elsewhere.

    spacing: between the cameras, world units.
    """

    def __init__(self, spacing: float) -> None:
        self._spacing = spacing
        self._objections: dict[str, str] = {}

    def object_to(self, cause: str, reason: str | None) -> None:
        """Declare lengths unknown for `reason`, one sentence for the user; None withdraws it.

        cause: which test objects; each has one reason at a time.
        """
        self._objections.pop(cause, None)
        if reason is not None:
            self._objections[cause] = reason

    def of(self, submaps: Sequence[Submap]) -> Metre:
        """Metre of all sub-maps together: sigma of the log of their joint length.

        What makes a sub-map's scale wrong, the kit and the bias of the matches, is common to all;
        so their errors add up as one, and more sub-maps do not make the sigma smaller.
        """
        if self._objections:
            return Metre(np.inf, next(iter(self._objections.values())))
        if not submaps:
            return Metre(np.inf, NO_WINDOW)
        length, net = np.array([_lengths(submap) for submap in submaps]).T
        sigma = np.minimum([submap.scale_log_sigma for submap in submaps], UNKNOWN)
        if length.sum() < STANDSTILL_SPACINGS * self._spacing:
            return Metre(np.inf, STOOD)
        log_sigma = float(length @ sigma / length.sum())
        if log_sigma <= METRIC_LOG_SIGMA:
            return Metre(log_sigma)
        if net.sum() < STRAY * length.sum():
            return Metre(log_sigma, STOOD)
        # to first order an error of the focal is one of the parallax, and that of the scale
        focal = max(submaps[-1].focal_log_sigma.tolist())
        return Metre(log_sigma, NO_FOCAL if focal > log_sigma / 2 else NO_PARALLAX)


def _lengths(submap: Submap) -> tuple[float, float]:
    """Length of the primary's path, and distance between its ends; world units."""
    centres = submap.T_s_c[: submap.n_primary, :3, 3]
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    return float(steps.sum()), float(np.linalg.norm(centres[-1] - centres[0]))
