"""Offset and drift between two cameras' clocks, fitted to their turn rates to parts of a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.interpolate import CubicSpline

from calm_edge.interchange.turn_rates import Rates
from calm_edge.types import Float, Int

# what free-running crystals have; clocks that count frames instead of time have more
DRIFT_PRIOR = 100e-6
# residuals are correlated over less than this: parallax stays the same through a curve
BLOCK_S = 5.0
CORRELATED_S = 10.0
FEW = 3.0
ITERATIONS = 12
LEAST_SAMPLES = 20
# error by motion faster than the frames show, as a share of the interval between frames
ALIASING = 0.03


@dataclass(frozen=True, slots=True)
class ClockFit:
    """Fitted relation of the clocks: primary = assistant + offset_s + drift (assistant - at_s).

    sigma_s: of the offset at at_s, the middle of the overlap. mixing: (3, 3), the assistant's
    rates are mixing @ the primary's. times, primary, assistant: common times (N,) on the
    assistant's clock and both rates (N, 3) there. explained: share of the assistant's power.
    """

    offset_s: float
    drift: float
    at_s: float
    sigma_s: float
    drift_sigma: float
    mixing: Float
    times: Float
    primary: Float
    assistant: Float
    explained: float

    def primary_time(self, assistant_s: Float) -> Float:
        """Times on the primary's clock of times on the assistant's."""
        return np.asarray(
            assistant_s + self.offset_s + self.drift * (assistant_s - self.at_s), np.float64
        )

    def at(self, assistant_s: float) -> float:
        """Offset [s] at a time on the assistant's clock."""
        return self.offset_s + self.drift * (assistant_s - self.at_s)

    @property
    def span_s(self) -> float:
        """Length of the common time."""
        return float(self.times[-1] - self.times[0])

    @property
    def roll_deg(self) -> float:
        """Rotation of the assistant's picture against the primary's, about the optical axis."""
        M = self.mixing
        return float(np.degrees(np.arctan2(M[1, 0] - M[0, 1], M[0, 0] + M[1, 1])))


def fit(primary: Rates, assistant: Rates, offset_s: float, drift: float, at_s: float) -> ClockFit:
    """Refine offset and drift, given at assistant time at_s, by weighted least squares.

    Unknowns are the offset, the drift and the mixing of the axes; the covariance is that of
    residuals summed over blocks, which are independent (Newey and West 1987). Raises ValueError
    without common time.
    """
    spline = CubicSpline(primary.t_s, primary.rate, axis=0)
    slope = spline.derivative()
    for _ in range(ITERATIONS):
        u = assistant.t_s + offset_s + drift * (assistant.t_s - at_s)
        inside = (u >= primary.start_s) & (u <= primary.end_s) & assistant.known
        index = np.clip(np.rint((u - primary.start_s) / primary.dt_s), 0, len(primary.known) - 1)
        inside &= primary.known[index.astype(int)]
        if inside.sum() < LEAST_SAMPLES:
            raise ValueError("no common time at this offset")
        t, b = assistant.t_s[inside], assistant.rate[inside]
        # the drift is fitted about the middle, where it and the offset are independent
        middle = (t[0] + t[-1]) / 2
        offset_s, at_s = offset_s + drift * (middle - at_s), middle
        a, da = spline(u[inside]), slope(u[inside])
        mixing, weight, residual = _regress(a, b)
        J = da @ mixing.T
        columns = _columns(a, J, t - at_s)
        normal, right = _normal(columns, residual, weight)
        normal[-1, -1] += DRIFT_PRIOR**-2
        right[-1] -= drift * DRIFT_PRIOR**-2
        step = np.linalg.lstsq(normal, right, rcond=None)[0]
        offset_s += float(np.clip(step[-2], -0.2, 0.2))
        drift += float(np.clip(step[-1], -1e-3, 1e-3))
        if abs(step[-2]) < 1e-7:
            break
    floor_s = ALIASING * float(np.hypot(primary.frame_s, assistant.frame_s))
    number = np.flatnonzero(inside)
    covariance = _covariance(columns, residual, weight, normal, number, assistant.dt_s)
    explained = 1 - (weight * residual**2).sum() / max((weight * b**2).sum(), 1e-30)
    return ClockFit(
        offset_s,
        drift,
        at_s,
        float(np.sqrt(covariance[0, 0] + floor_s**2)),
        float(np.sqrt(covariance[1, 1])),
        mixing,
        t,
        a,
        b,
        float(explained),
    )


def _regress(a: Float, b: Float) -> tuple[Float, Float, Float]:
    """Mixing (3, 3) with b = mixing a, weights (N, 3) and residuals (N, 3), Cauchy's."""
    weight = np.ones_like(b)
    for _ in range(4):
        rows = []
        for k in range(3):
            weighted = a * weight[:, k : k + 1]
            rows.append(np.linalg.lstsq(weighted.T @ a, weighted.T @ b[:, k], rcond=None)[0])
        mixing = np.array(rows)
        residual = b - a @ mixing.T
        scale = 1.48 * np.median(np.abs(residual), axis=0) + 1e-9
        weight = 1 / (scale**2 * (1 + (residual / (2.5 * scale)) ** 2))
    return mixing, weight, residual


def _columns(a: Float, J: Float, t: Float) -> Float:
    """Derivatives (N, 3, 11) of the prediction by mixing (9), offset and drift."""
    columns = np.zeros((len(a), 3, 11))
    for k in range(3):
        columns[:, k, 3 * k : 3 * k + 3] = a
    columns[:, :, 9] = J
    columns[:, :, 10] = J * t[:, None]
    return columns


def _normal(columns: Float, residual: Float, weight: Float) -> tuple[Float, Float]:
    weighted = columns * weight[:, :, None]
    normal = np.einsum("nki,nkj->ij", weighted, columns)
    return normal, np.einsum("nki,nk->i", weighted, residual)


def _covariance(
    columns: Float, residual: Float, weight: Float, normal: Float, number: Int, dt_s: float
) -> Float:
    """Covariance (2, 2) of offset and drift; number: (N,) index of each sample.

    The gradient's variance is that of a stationary residual with the autocorrelation found,
    sum_l C_J(l) C_r(l): a drive may have few curves, and then the scatter of the gradient over
    blocks shows little. Where the residual is larger in curves, the scatter is the larger.
    """
    last = columns[:, :, -2:]
    others = columns[:, :, :-2]
    A = np.einsum("nki,nk,nkj->ij", others, weight, others)
    B = np.einsum("nki,nk,nkj->ij", others, weight, last)
    J = last - np.einsum("nki,ij->nkj", others, np.linalg.lstsq(A, B, rcond=None)[0])
    top = int(number[-1] - number[0]) + 1
    at = number - number[0]
    grid_J, grid_r, seen = np.zeros((top, 3, 2)), np.zeros((top, 3)), np.zeros(top)
    grid_J[at], grid_r[at], seen[at] = J * weight[:, :, None], residual, 1.0
    reach = min(round(CORRELATED_S / dt_s), top - 1)
    size = next_fast_len(top + reach)
    spectrum = rfft(grid_J, size, axis=0)
    power = np.abs(rfft(grid_r, size, axis=0)) ** 2
    pairs = irfft(np.abs(rfft(seen, size)) ** 2, size)[: reach + 1]
    C_r = irfft(power, size, axis=0)[: reach + 1] / np.maximum(pairs, 1.0)[:, None]
    # tapered, so that the sum is a variance (Bartlett)
    C_r *= (1 - np.arange(reach + 1) / (reach + 1))[:, None]
    meat = np.zeros((2, 2))
    for i in range(2):
        for j in range(2):
            both = irfft(np.conj(spectrum[:, :, i]) * spectrum[:, :, j], size, axis=0)
            C_J = both[: reach + 1].copy()
            C_J[1:] += both[-1 : -reach - 1 : -1]
            meat[i, j] = float((C_J * C_r).sum())
    blocks = (at * dt_s // BLOCK_S).astype(int)
    sums = np.zeros((blocks[-1] + 1, 2))
    np.add.at(sums, blocks, np.einsum("nki,nk->ni", J, weight * residual))
    scatter = sums.T @ sums
    meat *= max(1.0, scatter[0, 0] / max(meat[0, 0], 1e-30))
    # what few curves show of their own residual is too small, as the mixing is fitted to them
    information = np.zeros(len(sums))
    np.add.at(information, blocks, np.einsum("nk,nk->n", J[:, :, 0] ** 2, weight))
    meat *= 1 + FEW * float((information**2).sum() / max(information.sum() ** 2, 1e-30))
    meat[1, 1] += DRIFT_PRIOR**-2
    inverse = np.linalg.pinv(normal)[-2:, -2:]
    return np.asarray(inverse @ meat @ inverse, np.float64)
