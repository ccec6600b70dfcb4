from __future__ import annotations

import numpy as np
import pytest

from calm_edge.backbones.bundle.birdseye import motion
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from tests.backbones.bundle import road_pictures as road

PERSPECTIVE = Perspective(410.0, 410.0, 319.5, 149.5, 640, 360)
FISHEYE = Fisheye(400.0, 400.0, 319.5, 149.5, 640, 360, (0.01, 0.0, 0.0, 0.0))
NORMAL = np.array([0.0, 1.0, 0.0]) / road.HEIGHT
AHEAD = np.array([0.0, 0.0, 1.0])


def seen(texture, camera, T, **how):
    pictures = [road.picture(texture, pose, camera, seed=k, **how) for k, pose in enumerate(T)]
    step = se3.inverse(T[1:]) @ T[:-1]
    t = 0.2 * np.arange(len(T))
    return motion(pictures, step[:, :3, :3], t, camera, NORMAL, AHEAD), T


@pytest.mark.parametrize("camera", [PERSPECTIVE, FISHEYE])
@pytest.mark.parametrize("step", [0.8, 2.5, 5.0])
def test_the_motion_along_a_textured_road_is_found(camera, step):
    found, T = seen(road.asphalt(), camera, road.drive(5, step))
    true = (se3.inverse(T[:-1]) @ T[1:])[:, :3, 3]
    assert np.linalg.norm(found - true, axis=1).max() < 0.1 * road.HEIGHT * 1.5


@pytest.mark.parametrize("texture", [road.smooth(), road.kerb()])
def test_a_road_without_texture_or_with_a_pattern_that_repeats_shows_no_motion(texture):
    assert seen(texture, PERSPECTIVE, road.drive(5))[0] is None


def test_a_road_that_changes_shows_no_motion():
    T = road.drive(5)
    pictures = [road.picture(road.asphalt(seed), T[0], PERSPECTIVE) for seed in range(5)]
    turn = np.tile(np.eye(3), (4, 1, 1))
    assert motion(pictures, turn, 0.2 * np.arange(5), PERSPECTIVE, NORMAL, AHEAD) is None
