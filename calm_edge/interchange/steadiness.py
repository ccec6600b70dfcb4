"""Detection of video whose camera changes from frame to frame: stabilised, or zoomed.

A rigid kit's cameras turn together. A stabilised one shows the slow turns of the other and little
of its shaking; one that is zoomed shows the same turn larger or smaller than before.
"""

from __future__ import annotations

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


def stabilised(fit: ClockFit, noise: tuple[float, float], frame_s: float) -> tuple[str, float]:
    """Compare the shaking of both cameras: ("primary" | "assistant" | "", ratio of powers).

    noise: sigma of the turn from frame to frame of each camera [widths]. frame_s: longest of both
    frame intervals. The named camera shakes less than LEAST_POWER of the other's power.
    """
    dt = float(np.median(np.diff(fit.times)))
    top = min(SHAKING_HZ[1], 0.4 / frame_s)
    if len(fit.times) * dt < BLOCK_S or top <= SHAKING_HZ[0]:
        return "", 1.0
    predicted, seen = (fit.primary @ fit.mixing.T)[:, :2], fit.assistant[:, :2]
    slow = butter(2, SLOW_HZ, "low", fs=1 / dt, output="sos")
    a, b = sosfiltfilt(slow, predicted, axis=0), sosfiltfilt(slow, seen, axis=0)
    common = float((a * b).sum() ** 2 / max((a * a).sum() * (b * b).sum(), 1e-30))
    if common < LEAST_COMMON:
        return "", 1.0
    # gain of the slow turns alone: that of all is biased by missing shaking
    gain = float((a * b).sum() / (a * a).sum())
    band = butter(2, (SHAKING_HZ[0], top), "band", fs=1 / dt, output="sos")
    unmixed = predicted * gain
    powers = [_power(sosfiltfilt(band, rate, axis=0)) for rate in (unmixed, seen)]
    # white noise of the steps, in this band; that of the primary as the assistant would show it
    share = (top - SHAKING_HZ[0]) * 2 * frame_s
    enlarged = gain * float(np.sqrt(np.linalg.norm(fit.mixing[:2, :2]) ** 2 / 2))
    noises = [
        2 * share * (s * k / frame_s) ** 2 for s, k in zip(noise, (enlarged, 1.0), strict=True)
    ]
    signal = [max(p - 4 * n, 0.0) for p, n in zip(powers, noises, strict=True)]
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
