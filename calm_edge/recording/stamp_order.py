"""Find and replace stamps that step back or repeat, among those of frames whose order is known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from calm_edge.recording import SequenceError
from calm_edge.types import Int

Bool = NDArray[np.bool_]

# A stamp is early if regular steps would have led further, by this share of a step.
TOLERANCE = 0.5
# If more stamps than this share are wrong, none can be trusted.
MAX_WRONG_SHARE = 0.3
# Nobody waits so long within a drive: a computer without a battery for its clock has set it.
LEAP_NS = 86_400 * 10**9
# wrong stamps at one end, where there is nothing to compare with on the other side
_END_SHARE = 0.1
_LONGEST = 1000
# One camera may start when the other ends: pictures that belong together are at most so far apart.
_MAX_APART_NS = 1_000_000_000


def ordered(t_ns: Int) -> tuple[Int, Bool]:
    """Replace stamps (N,) in ns that are out of order; return stamps and which are own ones (N,).

    Where a stamp is not after the one before, the shortest run of stamps there is replaced by equal
    steps, without which the rest follow at least as late as at the median step. If there is no such
    run, the clock was set: all stamps from there on are shifted, and the first is not its own. So
    they are at a step of more than LEAP_NS: a clock set ahead. With more wrong ones than
    MAX_WRONG_SHARE the stamps are returned as they are, still out of order.
    """
    steps = np.diff(t_ns)
    own = np.ones(len(t_ns), bool)
    if not (steps > 0).any() or not ((steps <= 0) | (steps > LEAP_NS)).any():
        return t_ns, own
    out, period = t_ns.copy(), int(np.median(steps[steps > 0]))
    for i in np.flatnonzero(steps <= 0) + 1:
        if out[i] > out[i - 1]:
            continue
        first, end = _wrong_run(out, int(i), period)
        if end > first:
            own[first:end] = False
            _fill(out, first, end, period)
        else:
            own[i] = False
            out[i:] += out[i - 1] + period - out[i]
        if not own.sum() >= (1 - MAX_WRONG_SHARE) * len(t_ns):
            return t_ns, own
    for i in np.flatnonzero(np.diff(out) > LEAP_NS) + 1:
        own[i] = False
        out[i:] += out[i - 1] + period - out[i]
    return out, own


def _wrong_run(t_ns: Int, i: int, period: int) -> tuple[int, int]:
    """Shortest run (first, end) with i - 1 or i in it without which the rest are in order."""
    n = len(t_ns)
    # in steps, relative to regular ones
    ahead = (t_ns - t_ns[i]) / period - (np.arange(n) - i)
    at_end = 1 + int(_END_SHARE * n)
    for length in range(1, min(_LONGEST, int(MAX_WRONG_SHARE * n) + 1) + 1):
        first = np.arange(max(1, i - length), min(i, n - 1 - length) + 1)
        fits = ahead[first + length] >= ahead[first - 1] - TOLERANCE
        if fits.any():
            found = int(first[np.argmax(fits)])
            return found, found + length
        if length <= at_end and i - length <= 0:
            return 0, length
        if length <= at_end and i + length >= n:
            return n - length, n
    return i, i


def _fill(t_ns: Int, first: int, end: int, period: int) -> None:
    """Replace a run of stamps by equal steps between its neighbours, or of a period at an end."""
    n, last = end - first, len(t_ns)
    after = int(t_ns[end]) if end < last else int(t_ns[first - 1]) + period * (n + 1)
    before = int(t_ns[first - 1]) if first > 0 else after - period * (n + 1)
    t_ns[first:end] = before + (after - before) * np.arange(1, n + 1) // (n + 1)


def check_common_time(path: Path, names: Sequence[str], stamps: Sequence[Int]) -> None:
    """Check that both cameras' stamps (N,), (M,) in ns overlap; raises SequenceError.

    path, names: of the drive and of its cameras, for the message.
    """
    ranges = [(int(t_ns.min()), int(t_ns.max())) for t_ns in stamps]
    if max(first for first, _ in ranges) - min(last for _, last in ranges) <= _MAX_APART_NS:
        return
    each = ", ".join(
        f"{name} {first / 1e9:.3f} to {last / 1e9:.3f} s"
        for name, (first, last) in zip(names, ranges, strict=True)
    )
    raise SequenceError(
        f"{path}: both cameras have no time in common: {each}; write their times on one clock, "
        "e.g. by adding a constant to those of one"
    )
