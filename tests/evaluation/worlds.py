"""Simulated drives with known errors."""

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import LocalizerUpdate, Metre, Prediction, Submap, Trajectory

STEP_NS = 100_000_000
METRE = Metre(0.01)


def curve(n: int = 240) -> np.ndarray:
    """Poses (n, 4, 4) of a winding drive in three dimensions, about one metre per frame."""
    u = np.linspace(0, 1, n)
    angle = 1.2 * np.sin(2 * np.pi * u)
    forward = np.stack([np.sin(angle), 0.1 * np.sin(9 * u), np.cos(angle)], 1)
    position = np.concatenate([np.zeros((1, 3)), np.cumsum(forward[:-1], 0)])
    return se3.compose(se3.so3_exp(np.stack([0 * u, angle, 0.05 * np.sin(7 * u)], 1)), position)


def stamps(n: int) -> np.ndarray:
    return np.arange(n, dtype=np.int64) * STEP_NS + 1_000_000_000


def update(
    T_w_c: np.ndarray,
    t_ns: np.ndarray,
    focal: tuple[float, float] = (500.0, 600.0),
    sigma: tuple[float, float] = (0.01, 0.01),
    submap_id: int = 0,
    scale: float = 1.0,
    stage_ms: dict[str, float] | None = None,
    metre: Metre = METRE,
) -> LocalizerUpdate:
    """An update with the given trajectory and a sub-map of two primary and one assistant view."""
    optics = (focal[0], focal[0], focal[1])
    cameras = tuple(Perspective(f, f, 319.5, 119.5, 640, 240) for f in optics)
    eye = np.tile(np.eye(4), (3, 1, 1))
    submap = Submap(
        submap_id,
        (0, 1),
        (0,),
        0,
        t_ns[[0, 1, 0]],
        eye,
        cameras,
        eye,
        cameras,
        scale,
        T_w_c[-1],
        np.array(sigma),
        scale_log_sigma=metre.log_sigma,
    )
    trajectory = Trajectory(np.arange(len(t_ns)), t_ns, T_w_c, np.eye(4), submap_id)
    prediction = Prediction(cameras, eye)
    return LocalizerUpdate(submap, prediction, trajectory, stage_ms or {}, metre=metre)
