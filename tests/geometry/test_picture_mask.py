"""A mask covers the picture, whatever the sizes of both."""

from __future__ import annotations

import numpy as np

from calm_edge.geometry.picture_mask import inside, kept, stretched

MASK = np.array([[0, 0, 0, 1], [0, 0, 1, 1]], np.uint8)


def test_pixels_are_looked_up_in_the_cell_that_covers_them() -> None:
    uv = np.array([[-0.5, -0.5], [299.4, 99], [299.6, 99], [250, 101], [399.5, 199.5], [450, -9]])
    assert inside(MASK, uv, (400, 200)).tolist() == [False, False, True, True, True, True]


def test_the_stretched_mask_agrees_with_the_lookup() -> None:
    shape = 37, 61
    rows, columns = np.indices(shape)
    uv = np.stack([columns.ravel(), rows.ravel()], 1).astype(float)
    large = stretched(MASK, shape)
    assert np.mean(large.ravel() == inside(MASK, uv, (61, 37))) > 0.97
    assert np.array_equal(kept(MASK, shape) == 0, large)
