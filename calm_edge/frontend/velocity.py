"""Velocity and turn rate of a camera from its recent poses, with their covariance."""

from __future__ import annotations

from collections import deque

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Int

WINDOW_NS = 400_000_000
# Share of an axis's deviation from the parabola that is taken from all three.
OF_ALL_AXES = 0.1
# No car changes its velocity between frames by more than this [m/s^2], six times full braking, and
# by more than this share of its speed: poses by far points alone are noisy.
MAX_ACCELERATION, MAX_VELOCITY_JUMP = 60.0, 0.6
_UNKNOWN = np.full((6, 6), np.nan)


def twist_now(t_ns: Int, T_o_c: Float, covariance: Float) -> tuple[Float, Float]:
    """Twist (6,) at the last stamp, units/s and rad/s, and its covariance (6, 6), camera axes.

    t_ns (N,), T_o_c (N, 4, 4), covariance (N, 6, 6) of (translation, rotation) in each camera's
    axes; poses are taken as independent. The twist is the slope of a fitted parabola at its end: a
    mean over the window would be delayed by half of it. Residuals beyond the noise of the poses, as
    on a bad road, are taken for a motion of third order, which changes the slope at the end most.
    Up to three poses leave no residuals: the covariance is NaN then. The twist is NaN for a single
    pose.
    """
    if len(t_ns) < 2:
        return np.full(6, np.nan), np.full((6, 6), np.nan)
    t_s = (t_ns - t_ns[-1]) * 1e-9
    powers = np.vander(t_s, min(3, len(t_ns)), increasing=True)
    weight = np.linalg.pinv(powers)[1]
    T_last_c = se3.inverse(T_o_c[-1]) @ T_o_c
    moved = np.concatenate([T_last_c[:, :3, 3], se3.so3_log(T_last_c[:, :3, :3])], -1)
    twist = weight @ moved
    J = np.zeros((len(t_ns), 6, 6))
    J[:, :3, :3] = J[:, 3:, 3:] = weight[:, None, None] * T_last_c[:, :3, :3]
    # the axes in which the velocity is given are uncertain themselves
    J[-1, :3, 3:] += se3.hat(twist[:3])
    total = np.einsum("nij,njk,nlk->il", J, covariance, J)
    total += np.diag(_misfit(powers, moved, covariance) * _of_third_order(powers, t_s))
    return twist, np.asarray(total)


def _misfit(powers: Float, moved: Float, covariance: Float) -> Float:
    """Sums (6,) of the squared residuals of moved (N, 6) about the parabola, less the poses' noise.

    powers: (N, 3) powers of time, the terms of the parabola. moved: translation and rotation vector
    relative to the last pose. Residuals no larger than the noise may be either, and count as half
    of each. A share OF_ALL_AXES is the mean over the axes of translation or of rotation, as few
    residuals of one axis can all be small by chance.
    """
    spare = len(moved) - powers.shape[1]
    if spare < 1:
        return np.full(6, np.nan)
    residual = moved - powers @ np.linalg.lstsq(powers, moved, rcond=None)[0]
    noise = np.diagonal(covariance, axis1=1, axis2=2).mean(0)
    seen = (residual**2).sum(0)
    excess = (seen**2 / np.maximum(seen + spare * noise, np.finfo(np.float64).tiny)).reshape(2, 3)
    mean = excess.mean(1, keepdims=True)
    return np.asarray((excess + OF_ALL_AXES * (mean - excess)).ravel())


def _of_third_order(powers: Float, t_s: Float) -> float:
    """Squared error of the slope at the end, of a motion that leaves residuals of square sum one.

    The motion is of third order in time, t_s (N,).
    """
    cubic = t_s**3
    fitted = np.linalg.lstsq(powers, cubic, rcond=None)[0]
    residual = cubic - powers @ fitted
    return float(fitted[1] ** 2 / max(residual @ residual, np.finfo(np.float64).tiny))


class RecentPath:
    """Poses T_o_c (4, 4) of the last WINDOW_NS, to predict the next pose and fit the twist."""

    def __init__(self) -> None:
        self._rows: deque[tuple[int, Float, Float, bool]] = deque()

    def __bool__(self) -> bool:
        return bool(self._rows)

    @property
    def newest_ns(self) -> int:
        return self._rows[-1][0]

    @property
    def newest(self) -> Float:
        return self._rows[-1][1]

    def add(
        self, t_ns: int, T_o_c: Float, covariance: Float = _UNKNOWN, *, own_stamp: bool = True
    ) -> None:
        """Add a pose with its covariance (6, 6), if known, and drop old ones.

        own_stamp: False if t_ns is not measured; such a pose gives no velocity.
        """
        self._rows.append((t_ns, T_o_c, covariance, own_stamp))
        while len(self._rows) > 2 and t_ns - self._rows[1][0] >= WINDOW_NS:
            self._rows.popleft()

    def clear(self) -> None:
        """Drop all poses."""
        self._rows.clear()

    def predict(self, t_ns: int) -> Float | None:
        """Extrapolate the last two poses to t_ns, (4, 4); None without a pose."""
        if len(self._rows) < 2:
            return self.newest if self._rows else None
        (t_0, T_0, *_), (t_1, T_1, *_) = self._rows[-2], self._rows[-1]
        return se3.interpolate(T_0, T_1, (t_ns - t_0) / (t_1 - t_0))

    def jumps(self, t_ns: int, T_o_c: Float) -> bool:
        """Whether no car moves from the last two poses [m] to this one; False without two.

        The step must differ as well as the velocity, so that a late stamp alone is no jump.
        """
        if len(self._rows) < 2 or not (self._rows[-1][3] and self._rows[-2][3]):
            return False
        (t_0, T_0, *_), (t_1, T_1, *_) = self._rows[-2], self._rows[-1]
        seconds = np.array([t_1 - t_0, t_ns - t_1]) * 1e-9
        steps = np.array([T_1[:3, 3] - T_0[:3, 3], T_o_c[:3, 3] - T_1[:3, 3]])
        velocities = steps / seconds[:, None]
        hard = np.linalg.norm(np.diff(velocities, axis=0)) > MAX_ACCELERATION * seconds.mean()
        return bool(hard and _differ(steps) and _differ(velocities))

    def twist(self) -> tuple[Float, Float]:
        """Twist (6,) at the newest pose and its covariance (6, 6), see `twist_now`.

        NaN if the newest pose has no stamp of its own.
        """
        if not self._rows[-1][3]:
            return np.full(6, np.nan), _UNKNOWN
        stamps, poses, covariances, _ = zip(*(row for row in self._rows if row[3]), strict=True)
        return twist_now(np.array(stamps, np.int64), np.stack(poses), np.stack(covariances))


def _differ(two: Float) -> bool:
    """Whether two vectors (2, 3) differ by more than MAX_VELOCITY_JUMP of the longer one."""
    longer = np.linalg.norm(two, axis=1).max()
    return bool(np.linalg.norm(two[1] - two[0]) > MAX_VELOCITY_JUMP * longer)
