"""No depth is used where a picture shows the car."""

from __future__ import annotations

import numpy as np

from calm_edge.offline.densify import used_depth
from calm_edge.types import Masks


def test_depth_is_unknown_in_the_masked_part_of_its_eye_alone() -> None:
    depth = np.full((3, 20, 40), 7, np.float32)
    masks = Masks(np.array([[0], [1]], np.uint8), None)
    used = used_depth(depth, masks, np.array([0, 1, 0]))
    assert (used[[0, 2], :10] == 7).all() and (used[[0, 2], 10:] == 0).all()
    assert (used[1] == 7).all() and (depth == 7).all()
    assert (used_depth(depth, None, np.array([0, 1, 0])) == 7).all()
