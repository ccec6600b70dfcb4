"""Mask images become text of the configuration and back."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.config import CaptureConfig, ConfigError
from calm_edge.kit.given_mask import cells_of, decoded, encoded, masks_of, shape_for


def image() -> np.ndarray:
    """White, with a black bonnet of a fifth of the height."""
    white = np.full((360, 640), 255, np.uint8)
    white[288:] = 0
    return white


def test_black_is_left_out() -> None:
    cells = cells_of(image())
    assert cells.shape == shape_for(640, 360) == (36, 64)
    assert cells[29:].all() and not cells[:28].any()


def test_the_text_holds_the_mask() -> None:
    cells = cells_of(image())
    back = decoded(encoded(cells))
    assert back is not None and np.array_equal(back, cells)
    masks = masks_of(CaptureConfig(mask_cells=("", encoded(cells))))
    assert masks.primary is None and np.array_equal(masks.assistant, cells)
    assert masks_of(CaptureConfig()).assistant is None


def test_a_mask_that_leaves_too_little_is_refused() -> None:
    with pytest.raises(ValueError, match="leaves 19 %"):
        cells_of(255 - image())


@pytest.mark.parametrize("text", ["3x3", "3x3:zz", "-1x2:00", "40x40:00", "ax3:00"])
def test_another_text_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"capture\.mask_cells"):
        decoded(text)
