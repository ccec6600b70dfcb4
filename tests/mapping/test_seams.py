import dataclasses

import numpy as np
import pytest

from calm_edge.geometry import se3, thin_plate
from calm_edge.mapping.deform import Deformation
from calm_edge.mapping.seams import MARKS, Seam, seams, summary
from calm_edge.types import AnchorTable


def rows(anchor, p_s):
    return dataclasses.replace(AnchorTable.empty(), anchor=np.asarray(anchor), p_s=p_s)


def rms(gaps):
    return np.sqrt((gaps**2).mean())


def moving(shift):
    p = np.random.default_rng(0).normal(size=(10, 3))
    return Deformation(thin_plate.fit(p, p + shift, 0.0), float(np.linalg.norm(shift)))


STILL = moving(np.zeros(3))


def test_gaps_are_the_distances_of_the_common_anchors_in_the_world():
    p_w = np.random.default_rng(1).normal(0, 5, (6, 3))
    T_w_a, T_w_b = (se3.exp(np.array([1.0, 2, k, 0.1, 0.5 * k, 0])) for k in (0, 1))
    a = rows([0, 1, 2, 3], se3.transform(se3.inverse(T_w_a), p_w[:4]))
    off = p_w[[5, 3, 2]] + [[9.0, 9, 9], [0.3, 0, 0], [0, 0.4, 0]]
    b = rows([5, 3, 2], se3.transform(se3.inverse(T_w_b), off))
    still = {4: STILL, 7: STILL}
    (seam,) = seams([(4, 7)], {4: a, 7: b}, {4: T_w_a, 7: T_w_b}, still)
    assert (seam.submap_a, seam.submap_b) == (4, 7)
    assert np.sort(seam.gaps_before) == pytest.approx([0.3, 0.4])
    assert seam.gaps_after == pytest.approx(seam.gaps_before)


def test_after_includes_the_deformation_of_both_submaps():
    p = np.random.default_rng(1).normal(0, 5, (6, 3))
    a, b = rows(np.arange(6), p), rows(np.arange(6), p + np.array([1.0, 0, 0]))
    deform = {0: moving(np.array([0.5, 0, 0])), 1: moving(np.array([-0.25, 0, 0]))}
    poses = {0: np.eye(4), 1: np.eye(4)}
    (seam,) = seams([(0, 1)], {0: a, 1: b}, poses, deform)
    assert rms(seam.gaps_before) == pytest.approx(1.0)
    assert rms(seam.gaps_after) == pytest.approx(0.25)


def test_marks_are_some_anchors_between_their_two_places():
    n = 3 * MARKS - 1
    p = np.random.default_rng(1).normal(0, 5, (n, 3))
    a, b = rows(np.arange(n), p), rows(np.arange(n), p + np.array([0.2, 0, 0]))
    T_w_s = se3.exp(np.array([1.0, 2, 3, 0, 0.5, 0]))
    (seam,) = seams([(0, 1)], {0: a, 1: b}, {0: T_w_s, 1: T_w_s}, {0: STILL, 1: STILL})
    assert seam.marks.shape == (MARKS, 4) and seam.marks.dtype == np.float32
    middle = se3.transform(T_w_s, p[::3] + np.array([0.1, 0, 0]))
    assert seam.marks[:, :3] == pytest.approx(middle, abs=1e-4)
    assert seam.marks[:, 3] == pytest.approx(0.2)


def test_submaps_without_a_common_anchor_have_no_seam():
    a, b = rows([1], np.ones((1, 3))), rows([2], np.ones((1, 3)))
    poses = {0: np.eye(4), 1: np.eye(4)}
    assert seams([(0, 1)], {0: a, 1: b}, poses, {0: STILL, 1: STILL}) == ()


def test_the_summary_weighs_all_anchors_equally():
    long = Seam(0, 1, np.full(90, 0.2, np.float32), np.full(90, 0.1, np.float32))
    short = Seam(1, 2, np.full(10, 5.0, np.float32), np.full(10, 3.0, np.float32))
    found = summary([long, short])
    assert found is not None
    assert (found.n_seams, found.n_anchors) == (2, 100)
    assert found.median_before == pytest.approx(0.2) and found.median_after == pytest.approx(0.1)
    assert found.p95_before == pytest.approx(5.0) and found.p95_after == pytest.approx(3.0)
    assert summary([]) is None
