"""What is attached to the car is masked, and only that: a wrong mask must not cost a drive."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.kit.ego_mask import MAX_SHARE, EgoMask, Evidence, remembered, shape_for

SIZE = (640, 360)
ROWS, COLUMNS = shape_for(*SIZE)


def evidence(fails: np.ndarray, follows: np.ndarray, still: np.ndarray | None = None) -> Evidence:
    """Two points in each cell of the masks (rows, columns)."""
    still = np.zeros_like(fails) if still is None else still
    return Evidence(2.0 * fails, 2.0 * follows, 2.0 * still)


def cells(rows: slice, columns: slice = slice(None)) -> np.ndarray:
    out = np.zeros((ROWS, COLUMNS), bool)
    out[rows, columns] = True
    return out


BONNET = cells(slice(-3, None))


def learned(windows: int, fails: np.ndarray, still: np.ndarray | None = None) -> EgoMask:
    mask = EgoMask()
    for _ in range(windows):
        mask.add(evidence(fails, ~fails, still))
    return mask


def test_cells_are_about_square() -> None:
    assert (ROWS, COLUMNS) == (18, 32)
    assert shape_for(360, 640) == (32, 18)


def test_points_are_counted_in_their_cells() -> None:
    uv = np.array([[0, 0], [639.4, 359.4], [25, 0]], np.float32)
    kinds = np.array([[1, 0, 0], [0, 1, 1], [1, 0, 0]], bool)
    found = Evidence.of_points(uv, *kinds, SIZE)
    assert found.fails.sum() == found.fails[0, 0] == found.still[0, 0] == 1
    assert found.follows[-1, -1] == found.follows[0, 1] == 1


def test_a_bonnet_is_masked_after_some_windows_and_nothing_else() -> None:
    assert learned(1, BONNET).cells is None
    mask = learned(4, BONNET).cells
    assert mask is not None and np.array_equal(mask > 0, BONNET)


def test_a_region_of_few_points_is_no_bonnet() -> None:
    mask, nothing = EgoMask(), np.zeros((ROWS, COLUMNS), bool)
    for _ in range(20):
        mask.add(evidence(nothing, ~BONNET))
    assert mask.cells is None


def test_what_a_mask_encloses_without_evidence_belongs_to_it() -> None:
    # the edge of a bonnet has texture, its middle has none
    edge = cells(slice(-4, -3))
    mask = EgoMask()
    for _ in range(5):
        mask.add(evidence(edge, cells(slice(0, -4))))
    assert mask.cells is not None and np.array_equal(mask.cells > 0, cells(slice(-4, None)))


def test_amid_the_picture_only_what_stands_still_is_masked() -> None:
    place = cells(slice(3, 5), slice(10, 14))
    assert learned(6, place).cells is None
    clock = learned(6, place, still=place).cells
    assert clock is not None and np.array_equal(clock > 0, place)


def test_a_mask_of_too_much_of_the_picture_is_not_used() -> None:
    most = cells(slice(-int(ROWS * MAX_SHARE) - 2, None))
    mask = learned(6, most)
    assert mask.too_large and mask.cells is None
    assert not learned(6, BONNET).too_large


def test_a_wrong_mask_is_unlearned_within_the_windows_that_a_certain_one_takes() -> None:
    mask = learned(50, BONNET)
    for _ in range(6):
        mask.add(evidence(np.zeros_like(BONNET), np.ones_like(BONNET)))
    assert mask.cells is None


def test_one_window_of_many_wrong_points_masks_nothing() -> None:
    mask = learned(3, np.zeros_like(BONNET))
    mask.add(Evidence(100.0 * BONNET, 0.0 * BONNET, 100.0 * BONNET))
    assert mask.cells is None


@pytest.mark.parametrize("wrong", [False, True])
def test_the_next_drive_begins_with_the_mask_and_can_change_it(wrong: bool) -> None:
    known = learned(20, BONNET).log_odds
    assert known is not None
    mask = EgoMask(remembered(known))
    assert mask.cells is not None
    shown = ~BONNET if not wrong else np.ones_like(BONNET)
    for _ in range(3):
        mask.add(evidence(~shown, shown))
    assert (mask.cells is None) == wrong


def test_pictures_of_another_size_begin_anew() -> None:
    mask = learned(9, BONNET)
    other = np.zeros(shape_for(640, 480), bool)
    mask.add(evidence(other, ~other))
    assert mask.cells is None
