"""Detection of video whose camera changes from frame to frame: stabilised, or zoomed.

A rigid kit's cameras turn together. A stabilised one shows the slow turns of the other and little
of its shaking; one that is zoomed shows the same turn larger or smaller than before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from calm_edge.interchange.clock_fit import ClockFit
from calm_edge.types import Float

SLOW_HZ = 0.7
SHAKING_HZ = (1.5, 5.0)
# stabilisers leave a twentieth of the power; cameras on one car differ by less than half
LEAST_POWER = 0.15
# share of the slow turns that both have to show, before they are compared
LEAST_COMMON = 0.5
BLOCK_S = 10.0
ZOOM_RATIO = 1.25
ZOOM_SIGMAS = 5.0


@dataclass(frozen=True, slots=True)
class Noise:
    """Noise of a camera's turns. sigma: of one step [widths]. frame_s: interval of the steps."""

    sigma: float
    frame_s: float

    def power(self, low_hz: float, top_hz: float, smooth_s: float) -> float:
        """Power of both shift rates in a band [(widths/s)^2], after the smoothing of the rates."""
        hz = np.linspace(low_hz, top_hz, 50)
        passed = np.exp(-((2 * np.pi * hz * smooth_s) ** 2)).mean() * (top_hz - low_hz)
        return float(2 * (self.sigma / self.frame_s) ** 2 * passed * 2 * self.frame_s)


def stabilised(fit: ClockFit, noise: tuple[Noise, Noise], smooth_s: float) -> tuple[str, float]:
    """Compare the shaking of both cameras: ("primary" | "assistant" | "", ratio of powers).

    smooth_s: of the rates. The named camera shakes with less than LEAST_POWER of the other's power.
    """
    dt = float(np.median(np.diff(fit.times)))
    low, top = SHAKING_HZ[0], min(SHAKING_HZ[1], 0.4 / max(n.frame_s for n in noise))
    if len(fit.times) * dt < BLOCK_S or top <= low:
        return "", 1.0
    slow = butter(2, SLOW_HZ, "low", fs=1 / dt, output="sos")
    a, b = (sosfiltfilt(slow, rate, axis=0) for rate in (fit.primary, fit.assistant[:, :2]))
    # of the slow turns alone: that of all is biased by missing shaking
    mixing = np.linalg.lstsq(a, b, rcond=None)[0]
    if 1 - ((b - a @ mixing) ** 2).sum() / max((b**2).sum(), 1e-30) < LEAST_COMMON:
        return "", 1.0
    band = butter(2, (low, top), "band", fs=1 / dt, output="sos")
    shown = fit.primary @ mixing, fit.assistant[:, :2]
    powers = [_power(sosfiltfilt(band, rate, axis=0)) for rate in shown]
    # the primary's noise as the assistant would show it
    enlarged = float((np.linalg.norm(mixing[:2]) ** 2) / 2)
    claimed = [n.power(low, top, smooth_s) for n in noise]
    claimed[0] *= enlarged
    signal = [max(p - n, 0.0) for p, n in zip(powers, claimed, strict=True)]
    if signal[0] > 0 and powers[1] < LEAST_POWER * signal[0]:
        return "assistant", powers[1] / signal[0]
    if signal[1] > 0 and powers[0] < LEAST_POWER * signal[1]:
        return "primary", powers[0] / signal[1]
    return "", powers[1] / max(powers[0], 1e-30)


def _power(rate: Float) -> float:
    # the median ignores a bump that one camera missed
    return float(np.median((rate**2).sum(1)) / np.log(2))


def zoomed(fit: ClockFit) -> tuple[float, float] | None:
    """Find a change of the ratio of both focal lengths: (assistant time [s], ratio), or None.

    The ratio of turns in blocks of BLOCK_S is compared before and after each block's end.
    """
    predicted, seen = (fit.primary @ fit.mixing.T)[:, :2], fit.assistant[:, :2]
    block = ((fit.times - fit.times[0]) // BLOCK_S).astype(int)
    n = int(block[-1]) + 1
    top, bottom, left = np.zeros(n), np.zeros(n), np.zeros(n)
    np.add.at(top, block, (predicted * seen).sum(1))
    np.add.at(bottom, block, (predicted**2).sum(1))
    gain = top / np.maximum(bottom, 1e-30)
    np.add.at(left, block, ((seen - gain[block][:, None] * predicted) ** 2).sum(1))
    count = np.bincount(block, minlength=n)
    # a turn shared well: residuals are correlated, so a block counts as few samples
    sigma = np.sqrt(left / np.maximum(bottom, 1e-30) * 10 / np.maximum(count, 1)) + 0.02
    good = (gain > 0) & (sigma < 0.1 * gain)
    log, log_sigma = np.log(np.where(good, gain, 1.0)), sigma / np.where(good, gain, 1.0)
    best: tuple[float, float, float] | None = None
    for k in range(1, n):
        sides = [good & (np.arange(n) < k), good & (np.arange(n) >= k)]
        if not all(side.any() for side in sides):
            continue
        weights = [1 / log_sigma[side] ** 2 for side in sides]
        means = [float(np.average(log[s], weights=w)) for s, w in zip(sides, weights, strict=True)]
        spread = float(np.sqrt(sum(1 / w.sum() for w in weights)))
        step = means[1] - means[0]
        strength = abs(step) / spread
        if abs(step) > np.log(ZOOM_RATIO) and strength > ZOOM_SIGMAS:
            found = (strength, fit.times[0] + k * BLOCK_S, float(np.exp(step)))
            best = found if best is None or found > best else best
    return None if best is None else (float(best[1]), best[2])
