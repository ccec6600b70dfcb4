import cv2
import numpy as np
import pytest

from bench.model.place_table import requirements
from bench.model.places import (
    SiftVlad,
    earlier,
    found_again,
    same_place,
)
from calm_edge.geometry import se3
from tests.bench.model.pictures import texture


def test_a_place_is_the_same_when_near_later_and_looking_the_same_way():
    turn = se3.so3_exp(np.array([0, np.pi, 0]))
    T = np.tile(np.eye(4), (5, 1, 1))
    T[:, 2, 3] = [0, 30, 60, 2, 4]
    T[4, :3, :3] = turn
    same = same_place(T, 2)
    assert np.argwhere(same).tolist() == [[3, 0]]


def test_recall_counts_only_what_a_precise_threshold_accepts():
    n = 6
    allowed = earlier(n, 1)
    same = np.zeros((n, n), bool)
    same[2, 0] = same[3, 1] = same[4, 0] = True
    likeness = np.zeros((n, n))
    likeness[2, 0], likeness[3, 1] = 0.9, 0.8
    assert found_again(likeness, same, allowed, 0.99).sum() == 2
    likeness[5, 2] = 0.85  # a false one between them
    assert found_again(likeness, same, allowed, 0.99).sum() == 1
    assert found_again(likeness, same, allowed, 0.65).sum() == 2
    likeness[1, 0] = 1.0  # no return at all, and the surest
    assert not found_again(likeness, same, allowed, 0.99).any()


def test_found_again_is_a_mask_over_pictures():
    allowed, same = earlier(5, 1), np.zeros((5, 5), bool)
    same[2, 0] = same[3, 1] = same[4, 0] = True
    likeness = np.zeros((5, 5))
    likeness[2, 0], likeness[3, 0], likeness[4, 0] = 0.9, 0.8, 0.7
    assert np.flatnonzero(found_again(likeness, same, allowed, 0.99)).tolist() == [2]
    # a threshold low enough to accept the wrong one
    assert np.flatnonzero(found_again(likeness, same, allowed, 0.6)).tolist() == [2, 4]


def test_the_requirement_is_judged_over_stretches_of_both_drives():
    many, few = np.arange(60) % 10 < 9, np.arange(60) % 10 < 5
    drives = {name: {"ours": many, "SIFT-VLAD": few} for name in ("a", "b")}
    (check,) = requirements(drives)
    assert check.passed and "2 drives" in check.what and "12 pairs" in check.measured
    swapped = {name: {"ours": few, "SIFT-VLAD": many} for name in drives}
    assert not requirements(swapped)[0].passed
    assert requirements({"a": {"SIFT-VLAD": few}}) == ()


def test_ties_are_accepted_together():
    allowed, same = earlier(3, 1), np.zeros((3, 3), bool)
    same[2, 0] = True
    assert not found_again(np.ones((3, 3)), same, allowed, 0.99).any()


def test_vlad_tells_a_shifted_picture_from_another():
    plane = [cv2.cvtColor(texture(seed), cv2.COLOR_GRAY2BGR) for seed in (0, 1, 2)]
    vlad = SiftVlad([plane[2]], words=16)
    crops = (plane[0][:300, :500], plane[0][10:310, 20:520], plane[1][:300, :500])
    here, again, other = (vlad.describe(crop) for crop in crops)
    assert np.linalg.norm(here) == pytest.approx(1, abs=1e-5)
    likeness = vlad.similarity(here[None], np.stack([again, other]))[0]
    assert likeness[0] > likeness[1] + 0.2
    blank = vlad.describe(np.full((100, 100, 3), 90, np.uint8))
    assert not blank.any()
