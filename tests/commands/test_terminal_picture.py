from __future__ import annotations

import re

import numpy as np

from calm_edge.commands.terminal_picture import GAP_PX, lines, side_by_side


def test_two_pictures_of_different_shape_stand_beside_each_other() -> None:
    left, right = np.full((40, 80, 3), 200, np.uint8), np.full((80, 80, 3), 100, np.uint8)
    joined = side_by_side(left, right, 20)
    assert joined.shape == (20, 2 * 20 + GAP_PX, 3)
    assert (joined[:10, :20] == 200).all() and not joined[10:, :20].any()
    assert not joined[:, 20 : 20 + GAP_PX].any() and (joined[:, 20 + GAP_PX :] == 100).all()


def test_a_character_has_the_colours_of_two_pixels() -> None:
    picture = np.zeros((4, 3, 3), np.uint8)
    picture[0, 0] = 1, 2, 3
    picture[1, 0] = 4, 5, 6
    first, second = lines(picture)
    assert first.startswith("\x1b[38;2;3;2;1;48;2;6;5;4m\u2580") and first.endswith("\x1b[0m")
    assert re.sub(r"\x1b\[[0-9;]*m", "", second) == "\u2580" * 3
