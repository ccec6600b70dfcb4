"""Search of the offset between two cameras' clocks over all of their overlap.

Each piece of the assistant's turn rates is compared with all of the primary's: the score of a lag
is the log likelihood ratio that the two are correlated, whatever the mixing of their axes is (the
cameras may be rolled, turned to the side, and of different focals).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.signal import butter, find_peaks, sosfiltfilt

from calm_edge.interchange.turn_rates import Rates
from calm_edge.types import Float

PIECE_S = 120.0
LEAST_OVERLAP_S = 4.0
MAX_DRIFT = 2e-3
# lags closer than this belong to one peak, and offsets of pieces to one line
WIDTH_S = 0.3
PEAKS = 4
# the best hypothesis has to lead the next one by this log likelihood ratio, and chance by as much
LEAST_LEAD = 8.0
# curves and the shaking by the road are scored apart: a curve has few independent samples
SPLIT_HZ = 0.5
_RIDGE = 1e-9


@dataclass(frozen=True, slots=True)
class Coarse:
    """Offset found by the search.

    offset_s: primary's time minus assistant's at assistant time at_s. drift: its change per second.
    score: log likelihood ratio. lead: by which it exceeds the best other offset; chance: what the
    best of as many lags has by chance.
    """

    offset_s: float
    drift: float
    at_s: float
    score: float
    lead: float
    chance: float

    @property
    def certain(self) -> bool:
        """Whether the offset stands out from chance and from all others."""
        return self.lead >= LEAST_LEAD and self.score >= self.chance + LEAST_LEAD


@dataclass(frozen=True, slots=True)
class _Peak:
    at_s: float
    offset_s: float
    score: float


def search(primary: Rates, assistant: Rates) -> Coarse | None:
    """Find the offset at which the turn rates of both cameras agree best; None without overlap.

    Both have the same interval.
    """
    peaks, lags = _peaks(primary, assistant)
    if not peaks:
        return None
    hypotheses = [(_support(peaks, *line), *line) for line in _lines(peaks)]
    hypotheses.sort(reverse=True)
    score, offset, drift, at = hypotheses[0]
    middle = (assistant.start_s + assistant.end_s) / 2
    best = offset + drift * (middle - at)
    others = [s for s, o, d, t in hypotheses[1:] if abs(o + d * (middle - t) - best) > 2 * WIDTH_S]
    chance = float(np.log(max(lags, 2))) * len({p.at_s for p in peaks})
    return Coarse(best, drift, middle, score, score - max(others, default=0.0), chance)


def _lines(peaks: list[_Peak]) -> list[tuple[float, float, float]]:
    """Offsets without drift through each peak, and with it through two: (offset, drift, at)."""
    lines = [(p.offset_s, 0.0, p.at_s) for p in peaks]
    strongest = sorted(peaks, key=lambda p: -p.score)[:80]
    for a, b in combinations(strongest, 2):
        if a.at_s != b.at_s:
            drift = (b.offset_s - a.offset_s) / (b.at_s - a.at_s)
            if abs(drift) <= MAX_DRIFT:
                lines.append((a.offset_s, drift, a.at_s))
    return lines


def _support(peaks: list[_Peak], offset: float, drift: float, at: float) -> float:
    best: dict[float, float] = {}
    for p in peaks:
        if abs(p.offset_s - offset - drift * (p.at_s - at)) < WIDTH_S:
            best[p.at_s] = max(best.get(p.at_s, 0.0), p.score)
    return sum(best.values())


def _peaks(primary: Rates, assistant: Rates) -> tuple[list[_Peak], int]:
    """Best lags of each piece of the assistant's rates, and the number of lags compared."""
    dt = primary.dt_s
    length = len(assistant.rate)
    pieces = max(1, round(length * dt / PIECE_S))
    bounds = np.linspace(0, length, pieces + 1).astype(int)
    peaks: list[_Peak] = []
    split = min(len(primary.rate), length) * dt >= LEAST_OVERLAP_S
    pairs = zip(_bands(primary, split), _bands(assistant, split), strict=True)
    bands = [_Band(p, a) for p, a in pairs]
    n_lags = 0
    for first, end in pairwise(bounds.tolist()):
        lag, score = _scores(primary, assistant, bands, first, end)
        n_lags = max(n_lags, len(lag))
        if not len(lag):
            continue
        # padded, since the best lag may be the first or the last
        found, _ = find_peaks(np.r_[-1.0, score, -1.0], distance=max(1, round(WIDTH_S / dt)))
        found = found - 1
        best = found[np.argsort(score[found])[::-1][:PEAKS]]
        at = assistant.start_s + dt * (first + end - 1) / 2
        shift = primary.start_s - assistant.start_s
        peaks += [_Peak(at, float(shift + dt * lag[i]), float(score[i])) for i in best]
    return peaks, n_lags


class _Band:
    """Shift rates of both cameras in one band of frequencies: (N, 2) and (M, 2)."""

    def __init__(self, primary: Float, assistant: Float) -> None:
        self.primary, self.assistant = primary, assistant
        self.effective = _effective_share(primary, assistant)


def _bands(rates: Rates, split: bool) -> list[Float]:
    filters = [
        butter(2, SPLIT_HZ, kind, fs=1 / rates.dt_s, output="sos") for kind in ("low", "high")
    ]
    if not split:
        return [rates.rate[:, :2]]
    return [
        np.where(rates.known[:, None], sosfiltfilt(sos, rates.rate[:, :2], axis=0), 0.0)
        for sos in filters
    ]


def _effective_share(a: Float, b: Float) -> float:
    """Share of independent samples of two autocorrelated series (Bartlett's formula)."""
    size = next_fast_len(2 * max(len(a), len(b)))

    def correlation(x: Float) -> Float:
        power = np.asarray((np.abs(rfft(x, size, axis=0)) ** 2).sum(1))
        series = np.asarray(irfft(power, size))
        return np.asarray(series / max(series[0], 1e-30), np.float64)

    product = correlation(a) * correlation(b)
    reach = min(200, len(a) - 1, len(b) - 1)
    return float(1 / max(1.0, 1 + 2 * product[1 : reach + 1].clip(0).sum()))


def _scores(
    primary: Rates, assistant: Rates, bands: list[_Band], first: int, end: int
) -> tuple[Float, Float]:
    """Lags [samples: the primary's index minus the assistant's] and their scores.

    The piece first:end of the assistant's rates is compared with all of the primary's. Summed over
    the bands, -n/2 log det(1 - K K^T) of the 2x2 canonical correlation matrix K, n the effective
    number of common samples.
    """
    ka, kb = primary.known.astype(float), assistant.known[first:end].astype(float)
    na, nb = len(ka), len(kb)
    size = next_fast_len(na + nb)

    def cross(x: Float, y: Float) -> Float:
        """Sums over i of x[i + lag] y[i], by lag from -(nb - 1) to na - 1."""
        full = irfft(rfft(x, size) * np.conj(rfft(y, size)), size)
        return np.asarray(np.r_[full[size - nb + 1 :], full[:na]], np.float64)

    count = cross(ka, kb)
    keep = count >= min(LEAST_OVERLAP_S / primary.dt_s, 0.5 * nb, 0.5 * na)
    n, score = count[keep], np.zeros(int(keep.sum()))
    for band in bands if keep.any() else ():
        a, b = band.primary, band.assistant[first:end]
        A, B, C = (np.zeros((len(n), 2, 2)) for _ in range(3))
        for i in range(2):
            for j in range(2):
                A[:, i, j] = cross(a[:, i] * a[:, j], kb)[keep] / n
                B[:, i, j] = cross(ka, b[:, i] * b[:, j])[keep] / n
                C[:, i, j] = cross(a[:, i], b[:, j])[keep] / n
        # with a share of the whole series' power: a lag at which nothing moves is no evidence
        A += np.eye(2) * (0.02 * a.var(0).mean() + _RIDGE)
        B += np.eye(2) * (0.02 * b.var(0).mean() + _RIDGE)
        KK = np.linalg.solve(A, C) @ np.linalg.solve(B, np.swapaxes(C, 1, 2))
        left = np.linalg.det(np.eye(2) - KK).clip(1e-6, 1.0)
        score -= 0.5 * n * band.effective * np.log(left)
    return np.arange(-(nb - 1.0), na)[keep] - first, score
