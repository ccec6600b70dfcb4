"""The drive: a line through the streets, a speed along it, and the sway of a car's body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3

Float = NDArray[np.float64]
STEP_M = 0.1


def resampled(points: Float, step: float = STEP_M) -> Float:
    """A polyline (N, 2) at even steps along its length."""
    s = np.r_[0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    at = np.arange(0, s[-1], step)
    return np.stack([np.interp(at, s, points[:, k]) for k in range(2)], 1)


def offset_right(points: Float, metres: float) -> Float:
    """The polyline (N, 2) of (x, z) moved to the right of its direction."""
    t = np.gradient(points, axis=0)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    return np.asarray(points + metres * np.stack([t[:, 1], -t[:, 0]], 1))


def rounded_loop(edges: list[Float], radii: Float) -> Float:
    """A closed line from open polylines (straight at their ends) joined by circular arcs.

    radii[i]: metres, of the corner that follows edge i.
    """
    out: list[Float] = []
    n = len(edges)
    trim_start, trim_end, arcs = np.zeros(n), np.zeros(n), []
    for i in range(n):
        a, b = edges[i], edges[(i + 1) % n]
        p, u = a[-1], (a[-1] - a[-2]) / np.linalg.norm(a[-1] - a[-2])
        q, v = b[0], (b[1] - b[0]) / np.linalg.norm(b[1] - b[0])
        # p + s u = q - r v: where the two straight ends would meet
        s, r = np.linalg.solve(np.stack([u, v], 1), q - p)
        corner = p + s * u
        angle = np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v)
        cut = radii[i] * np.tan(abs(angle) / 2)
        trim_end[i], trim_start[(i + 1) % n] = cut - s, cut - r
        normal = np.array([-u[1], u[0]]) * np.sign(angle)
        turn = np.linspace(0, abs(angle), 60)[1:-1, None]
        arcs.append(corner - cut * u + radii[i] * (np.sin(turn) * u + (1 - np.cos(turn)) * normal))
    for i, edge in enumerate(edges):
        s = np.r_[0, np.cumsum(np.linalg.norm(np.diff(edge, axis=0), axis=1))]
        keep = (s > trim_start[i]) & (s < s[-1] - trim_end[i])
        out += [edge[keep], arcs[i]]
    return np.concatenate(out)


def _smoothed(points: Float, metres: float) -> Float:
    """Arcs eased in and out, as a steering wheel turns."""
    n = round(metres / STEP_M) | 1
    kernel = np.hanning(n + 2)[1:-1]
    kernel /= kernel.sum()
    half = n // 2
    padded = np.pad(points, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    return np.stack([np.convolve(padded[:, k], kernel, "valid") for k in range(2)], 1)


@dataclass(frozen=True, slots=True)
class Limits:
    """speed m/s; accelerations m/s^2. start_speed m/s at time 0."""

    speed: float = 9.0
    sideways: float = 2.4
    speed_up: float = 2.2
    brake: float = 2.6
    start_speed: float = 3.0


@dataclass(frozen=True, slots=True)
class Mount:
    """The camera on the body: metres above ground and ahead of the rear axle."""

    height: float = 1.5
    ahead: float = 1.7


class Drive:
    """Poses at any time of a car whose rear axle follows a line (N, 2) of (x, z), metres."""

    def __init__(
        self, line: Float, seed: int, limits: Limits | None = None, mount: Mount | None = None
    ) -> None:
        limits, self.mount = limits or Limits(), mount or Mount()
        self.line = _smoothed(resampled(line), 3.0)
        tangent = np.gradient(self.line, axis=0)
        self.heading = np.unwrap(np.arctan2(tangent[:, 0], tangent[:, 1]))
        self.s = np.r_[0, np.cumsum(np.linalg.norm(np.diff(self.line, axis=0), axis=1))]
        bend = np.abs(np.gradient(self.heading) / np.gradient(self.s))
        v = np.minimum(limits.speed, np.sqrt(limits.sideways / np.maximum(bend, 1e-6)))
        step = np.diff(self.s)
        for i in range(len(v) - 2, -1, -1):
            v[i] = min(v[i], np.sqrt(v[i + 1] ** 2 + 2 * limits.brake * step[i]))
        v[0] = min(v[0], limits.start_speed)
        for i in range(1, len(v)):
            v[i] = min(v[i], np.sqrt(v[i - 1] ** 2 + 2 * limits.speed_up * step[i - 1]))
        self.speed = v
        self.time = np.r_[0, np.cumsum(2 * step / (v[1:] + v[:-1]))]
        rng = np.random.default_rng([seed, 21])
        self._hz = rng.uniform(0.5, 2.0, (6, 4))
        self._phase = rng.uniform(0, 2 * np.pi, (6, 4))

    @property
    def duration_s(self) -> float:
        return float(self.time[-1])

    def _sway(self, t: Float, channel: int) -> Float:
        """Unit-deviation wobble at 0.5 to 2 Hz."""
        waves = np.sin(2 * np.pi * self._hz[channel] * t[:, None] + self._phase[channel])
        return np.asarray(waves.sum(1) / np.sqrt(2))

    def on_ground(self, t: Float) -> Float:
        """T_world_car (N, 4, 4) at seconds t (N,): the rear axle on the ground, z ahead."""
        s = np.interp(t, self.time, self.s)
        x, z = (np.interp(s, self.s, self.line[:, k]) for k in range(2))
        zero = np.zeros_like(x)
        turn = np.stack([zero, np.interp(s, self.s, self.heading), zero], -1)
        return se3.compose(se3.so3_exp(turn), np.stack([x, zero, z], -1))

    def poses(self, t: Float) -> Float:
        """T_world_camera (N, 4, 4) at seconds t (N,); x right, y down, z forward, ground y = 0."""
        t = np.asarray(t, np.float64)
        T_w_car = self.on_ground(t)
        zero = np.zeros_like(t)
        drift = 0.12 * np.sin(0.37 * t + self._phase[5, 0]) + 0.06 * np.sin(1.1 * t)
        sway = np.radians(0.3) * np.stack(
            [self._sway(t, 0), 0.4 * self._sway(t, 1), self._sway(t, 2)], -1
        )
        offset = np.stack(
            [drift, 0.012 * self._sway(t, 3) - self.mount.height, zero + self.mount.ahead], -1
        )
        R_heading = T_w_car[:, :3, :3]
        p = T_w_car[:, :3, 3] + (R_heading @ offset[..., None])[..., 0]
        return se3.compose(R_heading @ se3.so3_exp(sway), p)
