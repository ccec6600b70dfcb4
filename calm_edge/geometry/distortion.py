"""OpenCV's distortion model of perspective lenses (calib3d, Detailed Description), vectorised.

q: normalised coordinates (2, ...). k: the leading coefficients of (k1, k2, p1, p2, k3, k4, k5, k6),
each a number, or (...) with one per point. f: focal length by which the result is multiplied.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Scale = Float | float


def distorted(q: Float, k: Sequence[Scale], f: Scale = 1.0) -> Float:
    """Distorted coordinates (2, ...) of q, times f."""
    x, y = q
    s = x * x + y * y
    out = f * radial(s, k)[0] * q
    if len(k) > 2:
        p1, p2 = _tangential(k)
        out[0] += f * (2 * p1 * x * y + p2 * (s + 2 * x * x))
        out[1] += f * (p1 * (s + 2 * y * y) + 2 * p2 * x * y)
    return np.asarray(out)


def distorted_jacobian(q: Float, k: Sequence[Scale], f: Scale = 1.0) -> Float:
    """Derivative (2, 2, ...), symmetric, of `distorted` by q."""
    x, y = q
    gain, slope = radial(x * x + y * y, k)
    J = np.empty((2, *q.shape))
    J[0, 0] = f * (gain + 2 * slope * x * x)
    J[1, 1] = f * (gain + 2 * slope * y * y)
    J[0, 1] = f * 2 * slope * x * y
    if len(k) > 2:
        p1, p2 = _tangential(k)
        J[0, 0] += f * (2 * p1 * y + 6 * p2 * x)
        J[1, 1] += f * (6 * p1 * y + 2 * p2 * x)
        J[0, 1] += f * (2 * p1 * x + 2 * p2 * y)
    J[1, 0] = J[0, 1]
    return J


def term_jacobian(q: Float, k: Sequence[Scale], f: Scale = 1.0) -> Float:
    """Derivative (len(k), 2, ...) of `distorted` by the coefficients k."""
    x, y = q
    s = x * x + y * y
    J = np.empty((len(k), *q.shape))
    for n, power in enumerate((1, 2, 0, 0, 3, 1, 2, 3)[: len(k)]):
        if power:
            J[n] = f * s**power * q
        else:
            J[n, n - 2], J[n, 3 - n] = f * 2 * x * y, f * (s + 2 * q[3 - n] ** 2)
    if len(k) > 5:
        J[[0, 1, 4]] /= _polynomial(s, k[5:])
        J[5:] *= -radial(s, k)[0] / _polynomial(s, k[5:])
    return J


def radial(s: Float, k: Sequence[Scale]) -> tuple[Scale, Scale]:
    """Radial distortion factor at squared radii s, and its derivative by s."""
    if not len(k):
        return 1.0, 0.0
    k123 = [*k[:2], *k[4:5]]
    gain, slope = _polynomial(s, k123), _slope(s, k123)
    if len(k) > 5:
        denominator = _polynomial(s, k[5:])
        gain = gain / denominator
        slope = (slope - gain * _slope(s, k[5:])) / denominator
    return gain, slope


def _tangential(k: Sequence[Scale]) -> tuple[Scale, Scale]:
    return k[2], (k[3] if len(k) > 3 else 0.0)


def _polynomial(s: Float, c: Sequence[Scale]) -> Scale:
    """1 + c1 s + c2 s^2 + ..."""
    return 1 + s * _horner(s, c)


def _slope(s: Float, c: Sequence[Scale]) -> Scale:
    """Derivative of `_polynomial` by s."""
    return _horner(s, [n * term for n, term in enumerate(c, 1)])


def _horner(s: Float, c: Sequence[Scale]) -> Scale:
    total = c[-1]
    for term in reversed(c[:-1]):
        total = term + s * total
    return total
