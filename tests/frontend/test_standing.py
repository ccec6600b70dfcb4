from __future__ import annotations

import numpy as np
import pytest

from calm_edge.frontend.standing import CELLS, STANDING, cells, still_share
from calm_edge.types import Float32

SIZE = (640, 240)


def corners(n: int = 400, seed: int = 0) -> Float32:
    return np.asarray(np.random.default_rng(seed).uniform(0, SIZE, (n, 2)), np.float32)


def test_cells_cover_the_picture() -> None:
    uv = np.array([[0, 0], [639.4, 239.4], [640, 240], [81, 49]], np.float32)
    last = CELLS[0] * CELLS[1] - 1
    assert cells(uv, SIZE).tolist() == [0, last, last, CELLS[0] + 1]


def test_it_is_the_part_of_the_picture_that_counts_not_the_corners() -> None:
    uv = corners()
    on_lorry = (uv[:, 0] < 240) & (uv[:, 1] > 96)
    crowd = np.concatenate([uv, *[uv[on_lorry]] * 9])
    moves = (crowd[:, 0] < 240) & (crowd[:, 1] > 96)
    assert moves.mean() > 0.7
    now = crowd + np.where(moves[:, None], np.float32([9, 0]), np.float32(0))
    share = still_share(crowd, crowd, np.asarray(now, np.float32), SIZE)
    assert share == pytest.approx(1 - 9 / 40, abs=0.03)


def test_a_shaking_car_stands_and_a_turning_one_does_not() -> None:
    uv = corners()
    assert still_share(uv, uv, uv + np.float32([1.2, -0.8]), SIZE) == 1.0
    assert still_share(uv, uv, uv + np.float32([8.0, 0.5]), SIZE) == 0.0


def test_lost_corners_are_not_still() -> None:
    uv = corners()
    kept = uv[:160]
    assert still_share(uv, kept, kept, SIZE) == pytest.approx(0.4, abs=0.05)


def test_driving_past_a_bonnet_is_not_standing() -> None:
    uv = corners(800)
    bonnet = uv[:, 1] > 168
    now = np.where(bonnet[:, None], uv, uv + 0.1 * (uv - np.float32([320, 100])))
    assert still_share(uv, uv, np.asarray(now, np.float32), SIZE) < STANDING - 0.1


def test_nothing_to_see_is_not_still() -> None:
    none = np.zeros((0, 2), np.float32)
    assert still_share(none, none, none, SIZE) == 0.0
    assert still_share(corners(), none, none, SIZE) == 0.0
