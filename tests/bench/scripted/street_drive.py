"""A short drive along a street, and batches as a front end forms them."""

from __future__ import annotations

import numpy as np

from bench.scripted import ScriptedScene, Street
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Float, Hints
from tests.drives import PERIOD_NS, START_NS, curved

T_P_A = se3.exp(np.array([0.54, 0.02, 0.03, 0.01, 0.02, -0.01]))


def street(n: int = 60, turn: float = 0.0) -> ScriptedScene:
    """n poses about 1 m apart, straight by default; two cameras of 640 px."""
    T = curved(n, turn=turn)
    return ScriptedScene(
        t_ns=START_NS + PERIOD_NS * np.arange(n),
        T_w_p=T,
        T_p_a=T_P_A,
        cameras=(Perspective.from_hfov(80, 640, 200), Perspective.from_hfov(90, 640, 240)),
        street=Street.along(T),
    )


def batch(first: int = 20, n: int = 10, late_ns: int = 0, loop: int | None = None) -> Hints:
    """n primary frames, as many assistant ones, and perhaps a loop keyframe."""
    t_ns = START_NS + PERIOD_NS * np.arange(first, first + n)
    stamps, eyes = [t_ns, t_ns + late_ns], [np.zeros(n), np.ones(n)]
    if loop is not None:
        stamps.append(np.array([START_NS + PERIOD_NS * loop]))
        eyes.append(np.zeros(1))
    return Hints(
        eyes=np.concatenate(eyes).astype(np.int64),
        t_ns=np.concatenate(stamps).astype(np.int64),
        loop=loop is not None,
    )


def truth(scene: ScriptedScene, hints: Hints) -> Float:
    """T_s_c (N, 4, 4) in world units."""
    T = scene.T_w_c(hints.eyes, hints.t_ns)
    return np.asarray(se3.inverse(T[0]) @ T)
