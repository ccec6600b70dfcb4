import numpy as np

from calm_edge.backbones.bundle.other_eye import MARGIN_PX, contradicted, region

PLANES, H, W = 32, 12, 20


def scores(best, height=0.9, floor=0.1):
    """Scores (PLANES, H, W) with a peak in the plane `best`, of both neighbours too."""
    plane = np.arange(PLANES)[:, None, None]
    out = np.full((PLANES, H, W), floor) + (height - floor) * np.exp(-((plane - best) ** 2))
    return out.astype(np.float32)


def test_a_depth_at_which_the_other_eye_matches_is_kept():
    plane = np.full((H, W), 10.4, np.float32)
    assert not contradicted(scores(10), plane).any()
    assert not contradicted(scores(12), plane).any()


def test_a_depth_at_which_it_does_not_match_is_not():
    plane = np.full((H, W), 10.0, np.float32)
    assert contradicted(scores(18), plane).all()
    assert contradicted(scores(3), plane).all()


def test_where_the_other_eye_matches_nowhere_it_says_nothing():
    plane = np.full((H, W), 10.0, np.float32)
    assert not contradicted(scores(18, height=0.3), plane).any()
    assert not contradicted(np.zeros((PLANES, H, W), np.float32), plane).any()


def test_of_two_places_that_match_about_as_well_neither_counts():
    plane = np.full((H, W), 10.0, np.float32)
    repeated = np.maximum(scores(10, height=0.8), scores(18, height=0.9))
    assert not contradicted(repeated, plane).any()


def test_only_the_region_that_moves_is_found():
    best = np.full((H, W), 10.0)
    best[:, 12:] = 20.0
    found = contradicted(scores(best), np.full((H, W), 10.0, np.float32))
    assert found[:, 13:].all() and not found[:, :11].any()


def test_single_pixels_do_not_count_and_a_region_has_the_margin_of_a_window():
    one = np.zeros((H, W), bool)
    one[6, 9] = True
    assert not region(one).any()
    one[6, 8:11] = True
    assert region(one).sum() == (2 * MARGIN_PX + 1) ** 2 and region(one)[6 - MARGIN_PX, 9]
