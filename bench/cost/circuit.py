"""Synthetic drive of any length: laps on a winding, hilly circuit."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from bench.scripted import ScriptedScene
from calm_edge.config import FrontendConfig
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Bytes, Float, Keyframe, LoopClosure, SubmapWindow
from device.frame import Eye, Frame

# Keyframes per lap, about one per metre; the car passes the same place again after a lap.
LAP = 1800
PERIOD_NS, START_NS = 100_000_000, 5_000_000_000
ASSISTANT_LATE_NS = 17_000_000
SIZE = (544, 208)
T_P_A = se3.exp(np.array([0.5, 0.02, 0.05, 0.02, -0.06, -0.03]))
# One loop closure in this many sub-maps, and sigma of the error of its relative pose: translation
# [world units], rotation [rad].
CLOSURE_EVERY = 5
_CLOSURE_SIGMA = np.array([0.05, 0.05, 0.05, 0.005, 0.005, 0.005])


def lap() -> Float:
    """T_w_p (LAP, 4, 4) of a closed lap: steps of about 1 m, bends both ways, 3 m up and down."""
    fine = np.linspace(0, 2 * np.pi, 40 * LAP, endpoint=False)
    radius = 240 * (1 + 0.25 * np.cos(3 * fine) + 0.05 * np.sin(11 * fine))
    path = np.stack([radius * np.sin(fine), 3 * np.cos(2 * fine), radius * np.cos(fine)], -1)
    step = np.linalg.norm(np.roll(path, -1, 0) - path, axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    at = np.searchsorted(along, np.arange(LAP) * along[-1] / LAP)
    ahead = np.roll(path, -1, 0)[at] - path[at]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    right = np.cross([0.0, 1.0, 0.0], ahead)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    return se3.compose(np.stack([right, np.cross(ahead, right), ahead], -1), path[at])


def scene(n: int) -> ScriptedScene:
    """Ground truth of n keyframes on the circuit, in a convex room of ground plane and dome."""
    T_w_p = lap()[np.arange(n) % LAP]
    return ScriptedScene(
        t_ns=START_NS + PERIOD_NS * np.arange(n),
        T_w_p=T_w_p,
        T_p_a=T_P_A,
        cameras=(Perspective.from_hfov(78.0, *SIZE), Perspective.from_hfov(70.0, *SIZE)),
    )


def n_keyframes(n_submaps: int, config: FrontendConfig) -> int:
    """Number of keyframes of each eye in `n_submaps` full windows."""
    return config.n_max + (n_submaps - 1) * (config.n_max - config.n_overlap)


def windows(n_submaps: int, config: FrontendConfig) -> Iterator[SubmapWindow]:
    """Yield `n_submaps` full windows in order.

    A generator: all windows of a drive at once would count in the memory that is measured.
    """
    new = config.n_max - config.n_overlap
    held: dict[Eye, list[Keyframe]] = {eye: [] for eye in Eye}
    for k in range(n_submaps):
        for eye, late_ns in ((Eye.PRIMARY, 0), (Eye.ASSISTANT, ASSISTANT_LATE_NS)):
            kept = held[eye][new:]
            first = k * new + len(kept)
            held[eye] = kept + [
                Keyframe(i, Frame(eye, i, START_NS + PERIOD_NS * i + late_ns, _picture(eye, i)))
                for i in range(first, k * new + config.n_max)
            ]
        yield SubmapWindow(
            submap_id=k,
            primary=tuple(held[Eye.PRIMARY]),
            assistant=tuple(held[Eye.ASSISTANT]),
            n_overlap=config.n_overlap if k else 0,
        )


def closures(n_keyframes: int, every: int) -> list[LoopClosure]:
    """Every `every` keyframes a true loop closure with the one a lap earlier, with pose noise."""
    rng = np.random.default_rng(0)
    return [
        LoopClosure(query, query - LAP, se3.exp(_CLOSURE_SIGMA * rng.standard_normal(6)))
        for query in range(LAP + every, n_keyframes, every)
    ]


def _picture(eye: Eye, number: int) -> Bytes:
    """Picture of smooth noise, different for each number.

    Pictures of the assistant are black, as a broadcast array of one byte.
    """
    width, height = SIZE
    if eye is Eye.ASSISTANT:
        return np.broadcast_to(np.zeros((), np.uint8), (height, width, 3))
    rng = np.random.default_rng(number)
    coarse = rng.integers(0, 256, (height // 16, width // 16, 3)).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, SIZE, interpolation=cv2.INTER_LINEAR), np.uint8)
