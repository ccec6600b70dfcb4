"""Points that do not follow the scene are found; at standstill nothing is learned."""

from __future__ import annotations

import cv2
import numpy as np

from calm_edge.estimator import ego_evidence
from calm_edge.estimator.ego_masks import EgoMasks
from calm_edge.geometry import se3
from calm_edge.kit.ego_mask import Evidence
from calm_edge.types import Bytes, Float, Masks
from tests.frontend.plane_world import CAMERA, HEIGHT, WIDTH, PlaneWorld, texture

WORLD = PlaneWorld()
BONNET = 60  # rows
DASHBOARD = texture(7)[:BONNET, :WIDTH]


def path(n: int, turn_rad: float, step_m: float = 0.25) -> Float:
    """Poses (n, 4, 4) that move sideways and turn."""
    return np.stack(
        [
            se3.compose(se3.so3_exp(np.array([0, k * turn_rad, 0])), [k * step_m, 0, 0])
            for k in range(n)
        ]
    )


def seen(T_w_c: Float, *, bonnet: bool = True) -> list[Bytes]:
    pictures = [WORLD.render(T) for T in T_w_c]
    for picture in pictures:
        if bonnet:
            picture[-BONNET:] = DASHBOARD
    return [np.asarray(cv2.cvtColor(p, cv2.COLOR_GRAY2BGR), np.uint8) for p in pictures]


def evidence(images: list[Bytes], T_s_c: Float) -> Evidence | None:
    eyes = np.zeros(len(images), np.int64)
    return ego_evidence.of_window(images, eyes, (CAMERA, CAMERA), T_s_c)[0]


def test_in_a_turn_a_dashboard_fails_and_stands_still() -> None:
    T_w_c = path(5, 0.03)
    found = evidence(seen(T_w_c), T_w_c)
    assert found is not None
    rows = found.fails.shape[0]
    top = rows - round(rows * BONNET / HEIGHT)
    assert found.still[top + 1 :].sum() > 30
    assert found.fails[top + 1 :].sum() > 10 * found.follows[top + 1 :].sum()
    assert found.follows[: top - 1].sum() > 30 * max(1, found.fails[: top - 1].sum())


def test_without_a_bonnet_everything_follows() -> None:
    T_w_c = path(5, 0.03)
    found = evidence(seen(T_w_c, bonnet=False), T_w_c)
    assert found is not None and found.follows.sum() > 100
    assert found.fails.sum() <= 0.02 * found.follows.sum()


def test_at_standstill_and_from_wrong_poses_nothing_is_learned() -> None:
    still = path(5, 0.0, 0.0)
    assert evidence(seen(still), still) is None
    moving = path(5, 0.03)
    nodding = np.stack([se3.exp(np.array([0, 0, 0, 0.04 * k, 0, 0])) for k in range(5)])
    assert evidence(seen(moving), moving @ nodding) is None


def test_a_bonnet_is_masked_over_a_drive_for_its_eye_alone() -> None:
    masks = EgoMasks(Masks())
    for window in range(4):
        T_w_c = path(4, 0.03)
        images = seen(T_w_c) + seen(T_w_c, bonnet=False)
        eyes = np.array([0] * 4 + [1] * 4)
        poses = np.concatenate([T_w_c, T_w_c])
        masks.add(window, images, eyes, (CAMERA, CAMERA), poses)
    found = masks.masks
    assert found is not None and found.primary is not None and found.assistant is None
    rows = found.primary.shape[0]
    top = rows - round(rows * BONNET / HEIGHT)
    assert found.primary[top + 1 :].mean() > 0.9 and found.primary[: top - 1].mean() == 0
    assert masks.log_odds[0] is not None and masks.notices == ()


def test_a_window_teaches_once() -> None:
    masks, T_w_c = EgoMasks(Masks()), path(4, 0.03)
    for _ in range(8):
        masks.add(0, seen(T_w_c), np.zeros(4, np.int64), (CAMERA, CAMERA), T_w_c)
    assert masks.masks is None


def test_a_given_mask_is_used_instead() -> None:
    given = np.zeros((2, 4), np.uint8)
    given[1] = 1
    masks = EgoMasks(Masks(None, given))
    assert masks.masks is not None and masks.masks.assistant is given
    masks.restore(Masks(given, None))
    assert masks.masks.primary is given


def test_residuals_are_those_of_a_scene_that_stands_still() -> None:
    T_b_a = se3.inverse(path(2, 0.03, 0.5)[1])
    rng = np.random.default_rng(0)
    uv = rng.uniform([50, 40], [WIDTH - 50, HEIGHT - 40], (200, 2)).astype(np.float32)
    depth = rng.uniform(3, 300, 200)
    p_b = se3.transform(T_b_a, CAMERA.back_project(uv.astype(np.float64), depth))
    there = CAMERA.project(p_b).astype(np.float32)
    assert ego_evidence.scene_residual(uv, there, CAMERA, T_b_a).max() < 0.05
    # mirrored at where they would be at infinity, as if they were behind the camera
    far = CAMERA.project(CAMERA.rays(uv.astype(np.float64)) @ T_b_a[:3, :3].T)
    near = depth < 10
    assert (
        ego_evidence.scene_residual(
            uv[near], (2 * far - there)[near].astype(np.float32), CAMERA, T_b_a
        ).min()
        > 3
    )
