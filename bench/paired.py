"""Paired comparison of two variants over drives and seeds: error ratio with a 95 % interval.

Errors of different drives differ by orders of magnitude, so logarithms of the ratios are averaged.
Runs on one drive are correlated, so the cluster bootstrap draws drives, then seeds within each.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from calm_edge.evaluation import EvaluationError
from calm_edge.types import Float

# (drive, seed) -> error; None after a failure.
Errors = Mapping[tuple[str, int], float | None]

SAMPLES = 10_000
SEED = 0
# Minimum number of pairs for a verdict other than `too few runs`.
MIN_PAIRS = 5
COLUMNS = ("compared", "ratio", "95 % from", "to", "drives", "pairs", "failed", "verdict")


@dataclass(frozen=True, slots=True)
class PairedRatio:
    """Geometric mean of error / reference error and its 95 % interval, equal weight per drive.

    ratio, low, high: below 1 the variant is better than the reference; None without a pair of
    finished runs. drives, pairs: numbers used. failed: number of runs of the variant that failed
    where the reference did not; reference_failed: the reverse.
    """

    ratio: float | None
    low: float | None
    high: float | None
    drives: int
    pairs: int
    failed: int
    reference_failed: int

    @property
    def verdict(self) -> str:
        """`better`, `worse`, `tie` if the interval includes 1, `too few runs` below MIN_PAIRS."""
        if self.pairs < MIN_PAIRS or self.low is None or self.high is None:
            return "too few runs"
        if self.high < 1:
            return "better"
        return "worse" if self.low > 1 else "tie"

    def within(self, target: float) -> bool:
        """Whether the ratio is at most `target`; its interval is not considered."""
        return self.ratio is not None and self.ratio <= target

    def row(self, name: str) -> list[Any]:
        """Table row with the columns COLUMNS; failures as `variant / reference`."""
        failed = f"{self.failed} / {self.reference_failed}"
        figures = [self.ratio, self.low, self.high, self.drives, self.pairs]
        return [name, *figures, failed, self.verdict]

    def to_dict(self) -> dict[str, Any]:
        """Fields and verdict as a dictionary for JSON."""
        return {name: getattr(self, name) for name in (*self.__slots__, "verdict")}


def compare(errors: Errors, reference: Errors, samples: int = SAMPLES) -> PairedRatio:
    """Compare the errors of a variant with those of a reference on their common (drive, seed).

    Interval: percentiles 2.5 and 97.5 of the cluster bootstrap (drives, then seeds, both with
    replacement); deterministic. With six drives it covered the true ratio in 88 % of 200 trials.
    Raises EvaluationError for an error that is not positive, or without common runs.
    """
    keys = sorted(errors.keys() & reference.keys())
    if not keys:
        raise EvaluationError("the two variants have no run of the same drive and seed")
    by_drive: dict[str, list[float]] = {}
    failed = reference_failed = 0
    for key in keys:
        error, of_reference = _finished(key, errors[key]), _finished(key, reference[key])
        if error is not None and of_reference is not None:
            by_drive.setdefault(key[0], []).append(math.log(error / of_reference))
        failed += error is None and of_reference is not None
        reference_failed += error is not None and of_reference is None
    logs = [np.array(drive) for drive in by_drive.values()]
    if not logs:
        return PairedRatio(None, None, None, 0, 0, failed, reference_failed)
    low, high = np.exp(np.percentile(_bootstrap(logs, samples), [2.5, 97.5]))
    ratio = math.exp(float(np.mean([drive.mean() for drive in logs])))
    pairs = sum(len(drive) for drive in logs)
    return PairedRatio(ratio, float(low), float(high), len(logs), pairs, failed, reference_failed)


def geometric_mean(errors: Errors) -> PairedRatio:
    """Geometric mean of errors, equal weight per drive, with its interval, see `compare`."""
    return compare(errors, dict.fromkeys(errors, 1.0))


def _finished(key: tuple[str, int], error: float | None) -> float | None:
    if error is None or math.isnan(error):
        return None
    if not 0 < error < math.inf:
        raise EvaluationError(f"{key[0]}, seed {key[1]}: an error of {error:g} is not positive")
    return error


def _bootstrap(logs: list[Float], samples: int) -> Float:
    """Bootstrap means (samples,): over drives drawn with replacement, of means over seeds likewise.

    logs: log ratios of the seeds of each drive.
    """
    rng = np.random.default_rng(SEED)
    n = np.array([len(drive) for drive in logs])
    table = np.zeros((len(logs), n.max()))
    for k, of_drive in enumerate(logs):
        table[k, : n[k]] = of_drive
    total = np.zeros(samples)
    for _ in logs:
        drive = rng.integers(0, len(logs), samples)
        seed = (rng.random((samples, n.max())) * n[drive, None]).astype(np.int64)
        used = np.arange(n.max()) < n[drive, None]
        total += (table[drive[:, None], seed] * used).sum(1) / n[drive]
    return total / len(logs)
