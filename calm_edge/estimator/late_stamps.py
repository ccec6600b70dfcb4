"""Time offset beyond the prior: a hypothesis that turns have to show (not in the paper).

A host may stamp one camera's pictures up to half a second late, and its clock may drift. Taken for
a wide prior this would be wrong on every straight: at constant velocity a time offset cannot be
distinguished from the rig's forward offset. In turns it can. From poses that are not tied by the
stamps (`Views`), the rotation from primary to assistant is computed for many offsets; it is the
same in all views at the true one alone, unless the car drives straight.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Int

# Largest offset that is looked for without any earlier estimate, and the distance of those tried.
MAX_OFFSET_S = 0.5
GRID_S = 0.02
# Stamps that far outside the primary's are still placed by extrapolation.
MARGIN_S = 0.15
MAX_SUBMAPS = 100
# Sigma of the prior on the drift as a hypothesis, and without it: clocks are right to 1e-4.
DRIFT_SIGMA, NO_DRIFT_SIGMA = 0.01, 1e-4
# Scale [rad] of the Cauchy kernel of a view's rotation: wide for the search, then as the views
# scatter, but at least the narrow one.
WIDE_RAD, NARROW_RAD = 5e-3, 5e-4
ITERATIONS = 12
# Views of one window err together: this many count as one.
CORRELATED_VIEWS = 4.0
# Sigma of errors that do not average out: of interpolation between keyframes, and of the focals.
SYSTEMATIC_SIGMA_S = 0.005
# An offset counts as found beyond this many sigmas and beyond the prior that needs no hypothesis
# (`kit/layout`: TIME_OFFSET_SIGMA_S), if its sigma is below MAX_SIGMA_S.
SIGNIFICANT_SIGMAS, LEAST_S, MAX_SIGMA_S = 4.0, 0.01, 0.02
LEAST_DRIFT = 5e-4
# Windows that show a drift: in fewer, a lens that is still being learned passes for one.
DRIFT_WINDOWS = 6
MIN_VIEWS = 4
# An offset is tried only if this share of the views then lies in its window.
LEAST_SHARE = 0.5
# Sigma of the prior on an offset that is looked for, and the largest that a drift may reach.
OFFSET_SIGMA_S, LARGEST_S = 0.3, 3.0
# Largest angle [rad] between the rays of a pixel in windows that are compared. A wrong lens turns
# the assistant's poses with the scene, as a wrong stamp does.
OTHER_LENS_RAD = 0.03
# Time on either side over which turn rates are averaged.
SPAN_S = 0.3


@dataclass(frozen=True, slots=True)
class Views:
    """Poses of one window that do not depend on the assistant's stamps, in any unit.

    t_p (N,), T_s_p (N, 4, 4): of the primary, increasing seconds. t_a (A,), T_s_a (A, 4, 4): of the
    assistant, by its stamps without any correction. rays: (N, 3) unit rays of the same pixels of
    both pictures, of the lenses that the poses are solved with.
    """

    t_p: Float
    T_s_p: Float
    t_a: Float
    T_s_a: Float
    rays: Float


@dataclass(frozen=True, slots=True)
class LateStamps:
    """Time offset at the instant t_s: exposure minus stamp, and its change per second.

    Sigmas include the systematic error; inf while nothing is known.
    """

    t_s: float = 0.0
    offset_s: float = 0.0
    drift: float = 0.0
    sigma_s: float = np.inf
    drift_sigma: float = np.inf

    def at(self, t_s: Float | float) -> Float:
        """Offset [s] at instants t_s."""
        return np.asarray(self.offset_s + self.drift * (np.asarray(t_s) - self.t_s))

    @property
    def significant(self) -> bool:
        """Whether the stamps contradict an offset within the prior."""
        return self.drifts or abs(self.offset_s) > max(LEAST_S, SIGNIFICANT_SIGMAS * self.sigma_s)

    @property
    def drifts(self) -> bool:
        """Whether the offset changes during the drive."""
        return abs(self.drift) > max(LEAST_DRIFT, SIGNIFICANT_SIGMAS * self.drift_sigma)

    @property
    def found(self) -> bool:
        """Whether the offset is significant and exact enough to correct the stamps by it."""
        return self.significant and self.sigma_s < MAX_SIGMA_S


GRID = np.arange(-MAX_OFFSET_S, MAX_OFFSET_S + GRID_S / 2, GRID_S)


class LateStampsEstimator:
    """Estimates `result` from the newest MAX_SUBMAPS windows."""

    def __init__(self) -> None:
        self._views: deque[Views] = deque(maxlen=MAX_SUBMAPS)
        self._tried: deque[Float] = deque(maxlen=MAX_SUBMAPS)
        self.result = LateStamps()

    def add(self, views: Views) -> None:
        """Estimate again with the views of one more window; forget those of other lenses."""
        if len(views.t_p) < 2 or len(views.t_a) < MIN_VIEWS:
            return
        for k in reversed(range(len(self._views))):
            if _apart_rad(self._views[k].rays, views.rays) > OTHER_LENS_RAD:
                del self._views[k], self._tried[k]
        self._views.append(views)
        self._tried.append(
            _Stack.of([views]).rotations(np.repeat(GRID[:, None], len(views.t_a), 1))
        )
        stack = _Stack.of(list(self._views))
        middle = (float(stack.t_a.min()) + float(stack.t_a.max())) / 2
        starts = [(_coarse(np.concatenate(list(self._tried), 1)), 0.0)]
        if self.result.found:
            starts.append((float(self.result.at(middle)), self.result.drift))
        fits = [_fit(stack, middle, *start, DRIFT_SIGMA) for start in starts]
        found = min(fits, key=lambda fit: fit[0])[1]
        if not found.drifts or len(self._views) < DRIFT_WINDOWS:
            found = _fit(stack, middle, found.offset_s, 0.0, NO_DRIFT_SIGMA)[1]
        self.result = found


def _apart_rad(a: Float, b: Float) -> float:
    """Largest angle [rad] between unit rays (N, 3), of those that both lenses have."""
    return float(np.nanmax(np.linalg.norm(a - b, axis=1)))


@dataclass(frozen=True, slots=True)
class _Stack:
    """K windows joined: P primary views, and V assistant views in their `window` (V,).

    key: (P,) increasing: t_p of all windows, each shifted so that windows do not overlap. shift,
    begin, end, last: (V,) of each assistant view's window: shift of its keys, first and last t_p,
    row of the latter.
    """

    key: Float
    R_s_p: Float
    shift: Float
    begin: Float
    end: Float
    last: Int
    t_a: Float
    R_s_a: Float
    window: Int

    @classmethod
    def of(cls, views: list[Views]) -> _Stack:
        begin = np.array([v.t_p[0] for v in views], np.float64)
        end = np.array([v.t_p[-1] for v in views], np.float64)
        last = np.cumsum([len(v.t_p) for v in views]) - 1
        window = np.repeat(np.arange(len(views)), [len(v.t_a) for v in views]).astype(np.int64)
        apart = float(end.max() - begin.min()) + 1.0
        shift = np.arange(len(views), dtype=np.float64) * apart
        return cls(
            np.concatenate([v.t_p + s for v, s in zip(views, shift.tolist(), strict=True)]),
            np.concatenate([v.T_s_p[:, :3, :3] for v in views]),
            shift[window],
            begin[window],
            end[window],
            last[window].astype(np.int64),
            np.concatenate([v.t_a for v in views]),
            np.concatenate([v.T_s_a[:, :3, :3] for v in views]),
            window,
        )

    def primary(self, t: Float) -> Float:
        """R_s_p (..., V, 3, 3) at instants t (..., V) of each view; extrapolated at the ends."""
        inside = np.clip(t, self.begin, self.end) + self.shift
        i = np.minimum(np.searchsorted(self.key, inside, side="right"), self.last) - 1
        left = self.key[i] - self.shift
        alpha = (t - left) / (self.key[i + 1] - self.key[i])
        R, R_next = self.R_s_p[i], self.R_s_p[i + 1]
        turn = se3.so3_log(np.swapaxes(R, -1, -2) @ R_next)
        return np.asarray(R @ se3.so3_exp(alpha[..., None] * turn))

    def rotations(self, late_s: Float) -> Float:
        """R_p_a (..., V, 3, 3) of views exposed late_s (..., V) after their stamps; NaN outside."""
        t = self.t_a + late_s
        R = np.swapaxes(self.primary(t), -1, -2) @ self.R_s_a
        R[(t < self.begin - MARGIN_S) | (t > self.end + MARGIN_S)] = np.nan
        return np.asarray(R)


def _mean_rotation(R: Float, weight: Float) -> Float:
    """Chordal mean (3, 3) of rotations (V, 3, 3)."""
    U, _, Vt = np.linalg.svd((weight[:, None, None] * R).sum(0))
    return np.asarray(U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt)


def _coarse(tried: Float) -> float:
    """The offset of GRID at which the rotations (G, V, 3, 3) agree best."""
    costs = []
    for R in tried:
        known = np.isfinite(R[:, 0, 0])
        if known.mean() < LEAST_SHARE:
            costs.append(np.inf)
            continue
        seen, weight = R[known], np.ones(int(known.sum()))
        for _ in range(3):
            turn = se3.so3_log(_mean_rotation(seen, weight).T @ seen)
            off2 = (turn**2).sum(1) / WIDE_RAD**2
            weight = 1 / (1 + off2)
        costs.append(float(np.log1p(off2).mean()))
    return float(GRID[int(np.argmin(costs))])


def _fit(
    stack: _Stack, middle: float, offset: float, drift: float, drift_sigma: float
) -> tuple[float, LateStamps]:
    """Robust Gauss-Newton of offset, drift and the rig's rotation; returns cost and estimate.

    middle: instant [s] to which the offset refers. drift_sigma: prior on the drift. Where a view
    turns with the rate w, its rotation
    changes by w per second of offset. The rate is averaged over SPAN_S on either side, because a
    noisy one would pass for information.
    """
    since, V = stack.t_a - middle, len(stack.t_a)
    mean, weight = np.eye(3), np.ones(V)
    cov = np.full((2, 2), np.inf)
    cost = np.inf
    for k in range(ITERATIONS):
        late = np.clip(offset + drift * since, -LARGEST_S, LARGEST_S)
        R = stack.rotations(late)
        known = np.isfinite(R[:, 0, 0])
        R[~known] = np.eye(3)
        weight = weight * known
        if weight.sum() < MIN_VIEWS:
            return np.inf, LateStamps()
        mean = _mean_rotation(R, weight)
        off = se3.so3_log(mean.T @ R)
        size = np.linalg.norm(off, axis=1)
        spread = float(np.median(size[known]))
        scale = WIDE_RAD if k < 3 else max(NARROW_RAD, 2 * spread)
        weight = known / (1 + (size / scale) ** 2)
        cost = float(np.log1p((size[known] / WIDE_RAD) ** 2).mean())
        rate = _rates(stack, late, mean)
        J = rate[..., None] * np.stack([np.ones(V), since], 1)[:, None, :]
        # the rig's rotation is free
        J = J - (weight[:, None, None] * J).sum(0) / weight.sum()
        noise2 = max(float((weight * size**2).sum() / weight.sum()) / 3, NARROW_RAD**2 / 3)
        prior = noise2 * CORRELATED_VIEWS * np.diag([OFFSET_SIGMA_S**-2.0, drift_sigma**-2.0])
        H = np.einsum("v,vki,vkj->ij", weight, J, J) + prior
        score = np.einsum("v,vki,vk->vi", weight, J, off)
        step = -np.linalg.solve(H, score.sum(0) + prior @ [offset, drift])
        offset, drift = offset + float(step[0]), drift + float(step[1])
        by_window = np.stack([np.bincount(stack.window, column) for column in score.T], 1)
        inverse = np.linalg.inv(H)
        cov = np.maximum(
            np.diag(inverse) * noise2 * CORRELATED_VIEWS,
            np.diag(inverse @ by_window.T @ by_window @ inverse),
        )
        if k > 4 and abs(step[0]) < 1e-5:
            break
    sigma = float(np.hypot(cov[0] ** 0.5, SYSTEMATIC_SIGMA_S))
    return cost, LateStamps(middle, offset, drift, sigma, float(cov[1] ** 0.5))


def _rates(stack: _Stack, late: Float, mean: Float) -> Float:
    """Change (V, 3) of each view's rotation residual per second of offset [rad/s]."""
    t = stack.t_a + late
    low, high = np.maximum(t - SPAN_S, stack.begin), np.minimum(t + SPAN_S, stack.end)
    turn = se3.so3_log(np.swapaxes(stack.primary(high), 1, 2) @ stack.primary(low))
    # of R_p_a in its own axes: those of the assistant
    return np.asarray(turn @ mean / np.maximum(high - low, SPAN_S / 2)[:, None])
