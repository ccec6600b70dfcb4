"""A synthetic window of two eyes with exact truth: points, path, kit, pixels."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calm_edge.backbones.bundle import problem
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Float

SIZE = np.array([[640, 240], [480, 200]])
DELAY_S = 0.017
PERIOD_S = 0.3


def theta_of(hfov_deg=(76.0, 66.0), rotation_deg=(1.0, -3.7, 1.2), radial=(0.0, 0.0)) -> Float:
    """A kit with two focals, global shutters and 4 degrees between its eyes."""
    theta = layout.prior(hfov_deg).mean
    theta[layout.READOUT] = 0.0
    theta[layout.DISTORTION[:, 0]] = radial
    theta[layout.RIG_ROTATION] = np.radians(rotation_deg)
    theta[layout.RIG_CENTRE] = np.array([0.99, 0.03, 0.1]) / np.linalg.norm([0.99, 0.03, 0.1])
    return theta


def turn(n: int, yaw_rad: float = 0.07) -> Float:
    """T_s_p (n, 4, 4) from the identity: 3 spacings a step, yaw and pitch that come and go."""
    k = np.arange(n - 1)
    steps = np.zeros((n - 1, 6))
    steps[:, 2] = 3.0
    steps[:, 0] = 0.1 * np.sin(k)
    steps[:, 3] = 0.1 * yaw_rad * np.cos(1.7 * k)
    steps[:, 4] = yaw_rad * (1 + np.sin(1.3 * k))
    T = [np.eye(4)]
    for step in se3.exp(steps):
        T.append(T[-1] @ step)
    return np.array(T)


@dataclass(frozen=True)
class Window:
    """What is measured and what is true."""

    m: problem.Measurements
    truth: problem.State

    @property
    def ties(self):
        return problem.rig_ties(self.m)


def window(
    T_s_p: Float,
    theta: Float,
    *,
    n_points: int = 150,
    noise_px: float = 0.0,
    outliers: float = 0.0,
    delay_s: float = DELAY_S,
    wide: float = 1.0,
    seed: int = 0,
) -> Window:
    """Points about a path, seen by both eyes; the assistant sits exactly on the rig.

    delay_s: of its exposures; its stamps are early by theta's time offset.
    wide: factor on the angles at which points are born.
    outliers: share of the pixels moved by up to 60 px. Points lie 3 to 300 spacings ahead.
    """
    rng = np.random.default_rng(seed)
    n = len(T_s_p)
    t = PERIOD_S * np.arange(n)
    T_s_a = se3.interpolate_at(t, T_s_p, t + delay_s) @ layout.rig(theta)
    T_c_s = se3.inverse(np.concatenate([T_s_p, T_s_a]))
    # a point is born in front of some view, nearer ones more often
    ahead = np.exp(rng.uniform(np.log(5), np.log(300), n_points))
    p_c = np.c_[
        wide * rng.uniform(-0.7, 0.7, n_points),
        wide * rng.uniform(-0.25, 0.2, n_points),
        np.ones(n_points),
    ]
    birth = T_s_p[rng.integers(0, n, n_points)]
    p_s = (birth[:, :3, :3] @ (p_c * ahead[:, None])[..., None])[..., 0] + birth[:, :3, 3]
    X = np.c_[p_s, np.ones(n_points)]
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    view, point = (index.ravel() for index in np.indices((2 * n, n_points)))
    every = problem.Measurements(
        view, point, np.zeros((len(view), 2)), np.full(len(view), 0.5),
        np.repeat([0, 1], n), np.concatenate([t, t + delay_s - theta[layout.TIME_OFFSET]]), SIZE,
    )  # fmt: skip
    truth = problem.State(T_c_s, X, theta)
    uv, z = problem.project(truth, every)
    seen = (z > 1e-3) & (uv >= 0).all(1) & (uv <= SIZE[every.eye[view]] - 1).all(1)
    seen &= z > 2 * X[point, 3]
    seen &= (np.bincount(point[seen], minlength=n_points) >= 3)[point]
    kept, point = np.unique(point[seen], return_inverse=True)
    uv = uv[seen] + noise_px * rng.standard_normal((len(point), 2))
    wrong = rng.random(len(point)) < outliers
    uv[wrong] += rng.uniform(-60, 60, (int(wrong.sum()), 2))
    m = replace(every, view=view[seen], point=point, uv=uv, sigma_px=np.full(len(point), 0.5))
    return Window(m, replace(truth, points=X[kept]))


def part(made: Window, first: int, n: int) -> Window:
    """The window of n views of each eye from view `first` of a longer one, in its own frame."""
    m, truth = made.m, made.truth
    views = np.concatenate([first + np.arange(n), m.n_views // 2 + first + np.arange(n)])
    rows = np.isin(m.view, views)
    rows &= (np.bincount(m.point[rows], minlength=len(truth.points)) >= 3)[m.point]
    kept, point = np.unique(m.point[rows], return_inverse=True)
    T_first = truth.T_c_s[first]
    X = truth.points[kept] @ T_first.T
    X /= np.linalg.norm(X, axis=1, keepdims=True)
    own = replace(
        m, view=np.searchsorted(views, m.view[rows]), point=point, uv=m.uv[rows],
        sigma_px=m.sigma_px[rows], eye=m.eye[views], t=m.t[views],
    )  # fmt: skip
    return Window(own, problem.State(truth.T_c_s[views] @ se3.inverse(T_first), X, truth.theta))


def perturbed(truth: problem.State, *, seed: int = 1, pose: float = 0.02, focal: float = 0.1):
    """A start near the truth: twists, points and rig off by `pose`, log focals by +-`focal`."""
    rng = np.random.default_rng(seed)
    twist = pose * rng.standard_normal((len(truth.T_c_s), 6))
    twist[0] = 0
    twist[:, 3:] /= 4
    points = truth.points + pose * truth.points[:, 3:] * rng.standard_normal(truth.points.shape)
    theta = truth.theta.copy()
    theta[layout.LOG_FOCAL] += focal, -focal
    theta[layout.RIG] += pose * rng.standard_normal(6)
    theta[layout.RIG_CENTRE] /= np.linalg.norm(theta[layout.RIG_CENTRE])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return problem.State(se3.exp(twist) @ truth.T_c_s, points, theta)
