"""Correct the assistant's stamps once turns have shown that they are wrong (late_stamps.py)."""

from __future__ import annotations

import numpy as np

from calm_edge.estimator.late_stamps import LEAST_S, LateStamps, LateStampsEstimator, Views
from calm_edge.kit import layout
from calm_edge.types import Float, Hints

# The correction follows the estimate if that has moved by the larger of this and its sigma.
MOVED_S = 0.004
# Once the offset is known to SETTLED_S, or after FIRST_WINDOWS on straight roads, only every
# CHECK_EVERY-th window is examined: for a drift, and because the poses take time.
SETTLED_S, FIRST_WINDOWS, CHECK_EVERY = 0.007, 30, 4
# Pixels of a picture at which lenses are compared; sizes [px] of pictures that are not known.
GRID, NOMINAL_SIZES = (9, 7), np.array([[640, 360]] * 2)
# A notice is given again if the offset has changed by this.
NOTICED_S = 0.05


class StampCorrection:
    """Collects windows and decides what the stamps are corrected by.

    notice: what is corrected, one line for the user; empty if nothing is. objection: why the
    stamps cannot be corrected although they are wrong, or None.
    """

    def __init__(self) -> None:
        self._estimator = LateStampsEstimator()
        self._applied: LateStamps | None = None
        self._seen: set[int] = set()
        self._start_ns: int | None = None
        self._noticed: LateStamps | None = None
        self.notice = ""
        self.objection: str | None = None

    def wanted(self, submap_id: int) -> bool:
        """Whether poses that do not depend on the stamps are wanted of a window."""
        if submap_id in self._seen:
            return False
        settled = self._estimator.result.sigma_s < SETTLED_S
        seldom = settled or len(self._seen) >= FIRST_WINDOWS
        return not seldom or submap_id % CHECK_EVERY == 0

    def late_s(self, hints: Hints) -> Float | None:
        """`Hints.late_s` of a window; None if its stamps are not corrected."""
        return None if self._applied is None else self.late_s_or_zero(hints)

    def late_s_or_zero(self, hints: Hints) -> Float:
        """Offset of each stamp (N,): exposure minus stamp, 0 for the primary [s]."""
        out = np.zeros(len(hints.t_ns))
        assistant = np.asarray(hints.eyes) == 1
        if self._applied is not None:
            out[assistant] = self._applied.at(self._seconds(hints)[assistant])
        return out

    @property
    def sigma_s(self) -> float:
        """Sigma of the correction [s]; 0 without one."""
        return 0.0 if self._applied is None else self._applied.sigma_s

    def add(self, submap_id: int, hints: Hints, T_s_c_apart: Float | None) -> bool:
        """Take a window's poses into account, once; return whether the correction has changed."""
        if T_s_c_apart is None or submap_id in self._seen:
            return False
        self._seen.add(submap_id)
        # a loop view has no pose there, and comes last
        n = len(T_s_c_apart)
        eyes, t = np.asarray(hints.eyes)[:n], self._seconds(hints)[:n]
        primary = eyes == 0
        placed = ~primary & np.isfinite(T_s_c_apart[:, 0, 0])
        views = Views(
            t[primary], T_s_c_apart[primary], t[placed], T_s_c_apart[placed], _rays(hints)
        )
        self._estimator.add(views)
        return self._decide(float(t[-1]))

    def _decide(self, now_s: float) -> bool:
        found = self._estimator.result
        self.objection = None
        if not found.found:
            # what has been corrected stays so
            if found.significant and self._applied is None:
                self.objection = f"the assistant's stamps do not fit: about {_late(found, 1)}"
            return False
        applied = self._applied or LateStamps()
        instants = np.array([2 * found.t_s - now_s, now_s])
        moved = float(np.abs(found.at(instants) - applied.at(instants)).max())
        if moved < max(MOVED_S, found.sigma_s):
            return False
        self._applied = found
        noticed = self._noticed
        changed = noticed is None or abs(noticed.offset_s - found.offset_s) > NOTICED_S
        if changed or (noticed is not None and found.drifts != noticed.drifts):
            self._noticed = found
            self.notice = f"{_stamps_are(found)}: corrected"
        return True

    def _seconds(self, hints: Hints) -> Float:
        """Stamps (N,) in seconds since the drive's first."""
        if self._start_ns is None:
            self._start_ns = int(hints.t_ns[0])
        return np.asarray((hints.t_ns - self._start_ns) * 1e-9)


def _rays(hints: Hints) -> Float:
    """Unit rays (N, 3) of pixels of both pictures under the belief on the kit."""
    kit = layout.prior(hints.hfov_deg, hints.sizes) if hints.kit is None else hints.kit
    sizes = NOMINAL_SIZES if hints.sizes is None else hints.sizes
    cameras = layout.cameras(kit.mean, sizes)
    return np.concatenate([camera.rays(camera.pixel_grid(*GRID)) for camera in cameras])


def _stamps_are(found: LateStamps) -> str:
    """`the assistant's stamps are 0.40 s late`, or that its clock is fast or slow, or both."""
    # a clock that is fast gives stamps that become later and later, so exposures before them
    clock = f"clock is {100 * abs(found.drift):.1f} % {'slow' if found.drift > 0 else 'fast'}"
    if not found.drifts:
        return f"the assistant's stamps are {_late(found, 2)}"
    if abs(found.offset_s) < LEAST_S:
        return f"the assistant's {clock}"
    return f"the assistant's stamps are {_late(found, 2)} and its {clock}"


def _late(found: LateStamps, digits: int) -> str:
    # a stamp that is late has an exposure before it
    return f"{abs(found.offset_s):.{digits}f} s {'late' if found.offset_s < 0 else 'early'}"
