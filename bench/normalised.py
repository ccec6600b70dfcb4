"""Normalised errors, error / sigma, of one quantity over many drives, and what is asked of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from bench.tables import Check
from calm_edge.types import Float

RMS = (0.7, 1.3)
MAX_BEYOND_3_PERCENT = 1.0
COLUMNS = ("errors over sigmas", "n", "rms", "beyond 3, %", "beyond 5, %", "median sigma")
NOT_REPORTED = "not reported"


@dataclass(frozen=True, slots=True)
class Normalised:
    """Errors of one quantity over the sigmas claimed for them.

    ratio: (N,) error / sigma of the errors with a finite sigma. claimed: median of the claimed
    sigmas, in `unit`; None without any. missing: number of errors without a finite sigma.
    """

    name: str
    ratio: Float
    claimed: float | None
    unit: str
    missing: int = 0

    @property
    def rms(self) -> float | None:
        return float(np.sqrt((self.ratio**2).mean())) if len(self.ratio) else None

    def beyond_percent(self, limit: float) -> float | None:
        """Share of the errors larger than `limit` sigmas; None without any."""
        return 100 * float((np.abs(self.ratio) > limit).mean()) if len(self.ratio) else None

    def row(self) -> tuple[object, ...]:
        """Table row with the columns COLUMNS."""
        claimed = NOT_REPORTED if self.claimed is None else f"{self.claimed:.3g} {self.unit}"
        beyond = self.beyond_percent(3), self.beyond_percent(5)
        return (self.name, len(self.ratio), self.rms, *beyond, claimed)

    def checks(
        self, limits: tuple[float, float] = RMS, most_beyond_3: float = MAX_BEYOND_3_PERCENT
    ) -> tuple[Check, ...]:
        """Requirements on the ratios; what is not reported meets none of them.

        limits: of the rms. most_beyond_3: share in percent.
        """
        rms, three, five = self.rms, self.beyond_percent(3), self.beyond_percent(5)
        (low, high), beyond = limits, f"{self.name}: beyond 3 sigma, %"
        return (
            _check(f"{self.name}: rms of error / sigma", f"{low} to {high}", rms, low, high),
            _check(beyond, f"<= {most_beyond_3:g}", three, 0, most_beyond_3),
            _check(f"{self.name}: beyond 5 sigma, %", "0", five, 0, 0),
        )

    def narrow(self, most: float, name: str) -> Check:
        """Requirement that the median claimed sigma is at most `most`, in `unit`."""
        what = f"{name}: median claimed sigma, {self.unit}"
        return _check(what, f"<= {most:g}", self.claimed, 0, most)


def normalised(
    name: str,
    errors: Iterable[float] | Float,
    sigmas: Iterable[float] | Float,
    unit: str = "%",
    claimed: float | None = None,
) -> Normalised:
    """Divide errors (N,) by sigmas (N,); sigmas that are not finite or 0 count as not reported.

    claimed: median sigma to show, by default 100 times that of `sigmas`, for errors of logs.
    """
    error, sigma = (np.array(list(values), np.float64) for values in (errors, sigmas))
    known = np.isfinite(sigma) & (sigma > 0) & np.isfinite(error)
    if claimed is None and known.any():
        claimed = 100 * float(np.median(sigma[known]))
    ratio = error[known] / sigma[known]
    return Normalised(name, ratio, claimed if known.any() else None, unit, int((~known).sum()))


def _check(what: str, asked: str, value: float | None, least: float, most: float) -> Check:
    if value is None:
        return Check(what, asked, NOT_REPORTED, False)
    return Check(what, asked, value, least <= value <= most)
