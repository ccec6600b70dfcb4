"""Scripted drives and the windows a front end would cut from them, without a picture."""

from __future__ import annotations

import numpy as np

from bench.scripted import ScriptedScene
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Float, Keyframe, SubmapWindow
from device.frame import Eye, Frame

PERIOD_NS = 100_000_000
START_NS = 5_000_000_000
BLANK = np.zeros((4, 4, 3), np.uint8)
T_P_A = se3.exp(np.array([0.55, 0.03, 0.05, 0.02, 0.07, -0.01]))


def curved(n: int, *, turn: float = 0.03) -> Float:
    """T_w_p (n, 4, 4) of a smooth drive: steps of about 1 m, yaw and pitch that come and go."""
    phase = np.arange(n - 1) / 9.0
    zero = np.zeros(n - 1)
    steps = np.stack(
        [
            0.02 * np.sin(phase),
            zero,
            1.0 + 0.2 * np.cos(phase / 2),
            0.004 * np.cos(phase),
            turn * (1 + np.sin(phase / 3)),
            zero,
        ],
        -1,
    )
    T = [np.eye(4)]
    for step in se3.exp(steps):
        T.append(T[-1] @ step)
    return np.array(T)


def circle(n: int, radius: float = 20.0) -> Float:
    """T_w_p (n, 4, 4) once around a level circle, the last pose one step before the first."""
    angle = 2 * np.pi / n
    step = se3.exp(np.array([0, 0, radius * angle, 0, angle, 0]))
    T = [np.eye(4)]
    for _ in range(n - 1):
        T.append(T[-1] @ step)
    return np.array(T)


def scene(T_w_p: Float, T_p_a: Float = T_P_A) -> ScriptedScene:
    """A scene at ten poses a second; 320 x 160 px of 80 degrees and 240 x 180 px of 60."""
    return ScriptedScene(
        t_ns=START_NS + PERIOD_NS * np.arange(len(T_w_p)),
        T_w_p=T_w_p,
        T_p_a=T_p_a,
        cameras=(Perspective.from_hfov(80, 320, 160), Perspective.from_hfov(60, 240, 180)),
    )


def windows(
    n: int, *, assistant_late_ns: int = 0, n_max: int = 15, n_overlap: int = 3
) -> list[SubmapWindow]:
    """Every scene pose a keyframe of both eyes, cut as IV-A does."""
    eyes = {eye: [] for eye in Eye}
    for eye, late_ns in ((Eye.PRIMARY, 0), (Eye.ASSISTANT, assistant_late_ns)):
        for k in range(n):
            frame = Frame(eye, k, START_NS + PERIOD_NS * k + late_ns, BLANK)
            eyes[eye].append(Keyframe(k, frame))
    out: list[SubmapWindow] = []
    for start in range(0, n - n_overlap, n_max - n_overlap):
        cut = slice(start, start + n_max)
        out.append(
            SubmapWindow(
                submap_id=len(out),
                primary=tuple(eyes[Eye.PRIMARY][cut]),
                assistant=tuple(eyes[Eye.ASSISTANT][cut]),
                n_overlap=n_overlap if out else 0,
            )
        )
    return out


def position_error(T: Float, T_true: Float) -> Float:
    """(N,) distances after both are put on their first pose."""
    T, T_true = se3.inverse(T[0]) @ T, se3.inverse(T_true[0]) @ T_true
    return np.linalg.norm((T - T_true)[:, :3, 3], axis=-1)
