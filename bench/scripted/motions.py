"""Motions on which a focal length is or is not observable, and the pixels that a camera sees."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction.matches import from_landmarks
from calm_edge.correction.test_bank import BankGroup, GroupBuilder
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.types import Float, Landmarks

SIZE = (1226, 370)
CAMERA = Perspective(700.0, 700.0, 612.5, 184.5, *SIZE)
N_VIEWS = 15


def motion(kind: str, n: int = N_VIEWS) -> Float:
    """T_w_c (n, 4, 4) on a car with a rear axle that moves 1 m per view.

    kind: `straight`; `tangent`, an arc with the optical axis tangent to it; `ahead`, camera 1.5 m
    in front of the axle; `yawed`, camera over the axle, yawed by 15 degrees; `general`, varying yaw
    and pitch. A leading `-` mirrors the motion.
    """
    name, phase = kind.lstrip("-"), np.arange(n - 1) / 4
    yaw, pitch, mount, ahead = np.full(n - 1, np.radians(3.0)), np.zeros(n - 1), np.zeros(3), 0.0
    if name == "straight":
        yaw = np.zeros(n - 1)
    elif name == "ahead":
        ahead = 1.5
    elif name == "yawed":
        mount = np.array([0, np.radians(15), 0])
    elif name == "general":
        yaw, ahead = yaw * (1 + np.sin(phase)), 1.5
        pitch = np.radians(0.5) * np.cos(2 * phase)
    else:
        assert name == "tangent"
    T = [np.eye(4)]
    for down, right in zip(pitch, yaw, strict=True):
        # half of the turn before the step and half after it keep the axle on its arc
        half = se3.compose(se3.so3_exp(np.array([down / 2, right / 2, 0])), np.zeros(3))
        T.append(T[-1] @ half @ se3.compose(np.eye(3), np.array([0, 0, 1.0])) @ half)
    T_w_c = np.array(T) @ se3.compose(se3.so3_exp(mount), np.array([0, 0, ahead]))
    mirror = np.diag([-1.0, 1, 1, 1])
    return mirror @ T_w_c @ mirror if kind.startswith("-") else T_w_c


def seen(
    T_w_c: Float,
    seed: int,
    *,
    camera: Camera = CAMERA,
    noise_px: float = 0.3,
    outliers: float = 0.0,
    points: int = 1500,
) -> Landmarks:
    """Pixels of random points around the path in every view.

    outliers: share of pixels that are drawn uniformly in the picture.
    """
    rng = np.random.default_rng(seed)
    p = rng.uniform([-18, -6, 3], [18, 1.6, 50], (points, 3))
    p[np.abs(p[:, 0]) < 4, 1] = 1.6
    near = T_w_c[rng.integers(0, len(T_w_c), points)]
    p_w = np.einsum("nij,nj->ni", near[:, :3, :3], p) + near[:, :3, 3]
    index, view, pixels = [], [], []
    for n, T in enumerate(T_w_c):
        p_c = se3.transform(se3.inverse(T), p_w)
        uv = camera.project(p_c)
        (ids,) = np.nonzero((p_c[:, 2] > 1) & (uv > 0).all(1) & (uv < np.array(SIZE) - 1).all(1))
        uv = uv[ids] + rng.normal(size=(len(ids), 2)) * noise_px
        wrong = rng.random(len(ids)) < outliers
        uv[wrong] = rng.uniform(0, SIZE, (wrong.sum(), 2))
        index.append(ids)
        view.append(np.full(len(ids), n))
        pixels.append(uv)
    return Landmarks(
        points_s=p_w,
        index=np.concatenate(index),
        view=np.concatenate(view),
        uv=np.concatenate(pixels).astype(np.float32),
    )


@lru_cache(maxsize=64)
def group(
    kind: str,
    seed: int,
    *,
    guess: float = 700.0,
    focal: float = 700.0,
    off_px: tuple[float, float] = (0.0, 0.0),
    noise_px: float = 0.3,
    outliers: float = 0.0,
) -> BankGroup:
    """Matches on which focal lengths are tested, of the views of one motion.

    Their information on the focal is computed at `guess`, px. off_px: offset of the true principal
    point from the guessed one.
    """
    cx, cy = CAMERA.cx + off_px[0], CAMERA.cy + off_px[1]
    camera = replace(CAMERA, fx=focal, fy=focal, cx=cx, cy=cy)
    landmarks = seen(motion(kind), seed, camera=camera, noise_px=noise_px, outliers=outliers)
    views, shape = range(N_VIEWS), CAMERA.with_focal(guess)
    builder = GroupBuilder(from_landmarks(landmarks), views, views, CorrectionConfig())
    built = builder.finish(shape)
    assert built is not None
    return built
