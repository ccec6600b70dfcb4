"""Candidates are triangulated exactly, once the parallax suffices."""

from __future__ import annotations

import numpy as np

from calm_edge.frontend.candidates import MIN_PARALLAX_RAD, Candidates, replenish, step
from tests.frontend.plane_world import CAMERA, DEPTH, PlaneWorld, drive

WORLD = PlaneWorld()


def test_points_are_triangulated_on_the_wall_once_there_is_parallax() -> None:
    poses = drive(12, 0.1)
    images = [WORLD.render(T) for T in poses]
    nothing = np.zeros((0, 2), np.float32)
    known = replenish(Candidates.none(), images[0], nothing, poses[0], 100)
    assert 20 < len(known.uv) <= 100
    ripened = []
    for i in range(1, 12):
        known, p_m, uv = step(known, images[i - 1], images[i], CAMERA, poses[i])
        assert len(p_m) == len(uv)
        moved = np.linalg.norm(poses[i][:3, 3] - poses[0][:3, 3])
        if moved < 0.5 * MIN_PARALLAX_RAD * (DEPTH - poses[i][2, 3]):
            assert len(p_m) == 0
        ripened.append(p_m)
    points = np.concatenate(ripened)
    assert len(points) > 20
    assert np.median(np.abs(points[:, 2] - DEPTH)) < 0.02 * DEPTH


def test_new_corners_keep_a_distance_from_taken_pixels() -> None:
    T = drive(1)[0]
    image = WORLD.render(T)
    first = replenish(Candidates.none(), image, np.zeros((0, 2), np.float32), T, 60)
    second = replenish(Candidates.none(), image, first.uv, T, 60)
    gaps = np.linalg.norm(first.uv[:, None] - second.uv[None], axis=-1)
    assert len(second.uv) and gaps.min() > 5


def test_no_corners_are_taken_where_the_picture_is_left_out() -> None:
    T = drive(1)[0]
    image, nothing = WORLD.render(T), np.zeros((0, 2), np.float32)
    mask = np.array([[0], [1]], np.uint8)
    found = replenish(Candidates.none(), image, nothing, T, 100, mask)
    assert len(found.uv) > 20 and found.uv[:, 1].max() < image.shape[0] / 2
    assert replenish(Candidates.none(), image, nothing, T, 100).uv[:, 1].max() > image.shape[0] / 2
