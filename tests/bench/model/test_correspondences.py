import numpy as np
import pytest

from bench.model import correspondences, match_table
from bench.model.correspondences import (
    COLUMNS,
    against,
    judge,
    measure_pair,
    query_points,
    retained_against,
    rows,
)
from bench.model.matchers import KltMatcher
from bench.model.protocols import Matches
from bench.model.scenes import Pair, Side
from bench.model.truth import transfer
from tests.bench.model.pictures import camera, pose, texture, view


def pair(place, case="3 on", scene="plane"):
    plane = texture(place)
    sides = [Side(*view(camera(), pose(x), plane), seed=place) for x in (0.0, 0.3)]
    return Pair(case, scene, place, *sides)


class Exact:
    """Matcher with the truth of a pair, correct for a given share of clear pictures."""

    def __init__(self, pair, share, worse_share):
        self.pair, self.share, self.worse = pair, share, worse_share

    def match(self, image_a, image_b, query_uv):
        uv, _ = transfer(self.pair.a.truth, self.pair.b.truth, query_uv)
        share = self.share if image_a is self.pair.a.image else self.worse
        found = np.arange(len(uv)) % 10 < 10 * share
        return Matches(uv + 0.1, found, np.full(len(uv), 0.1))


def test_queries_are_of_both_kinds_and_seen_in_the_other_picture():
    made = pair(0)
    uv, kind = query_points(made)
    assert transfer(made.a.truth, made.b.truth, uv)[1].all()
    assert 20 < (kind == 0).sum() <= correspondences.QUERIES
    assert 20 < (kind == 1).sum() <= correspondences.QUERIES


def test_judging_counts_what_was_found_and_how_far_off():
    truth = np.zeros((4, 2))
    there = np.array([[0.6, 0.8], [0, 0.5], [0, 2.0], [0, 9.0]])
    found = np.array([True, False, True, True])
    within, n_found, error, claimed = judge(Matches(there, found, np.full(4, 1.0)), truth)
    assert within == (1, 2) and n_found == 3
    assert error == pytest.approx(1.5)
    assert claimed == pytest.approx(np.sqrt((1 + 4) / 2 / 2))


def test_the_better_matcher_wins_and_the_sturdier_one_keeps_more():
    scores = []
    for scene in ("a", "b", "c"):
        for place in range(2):
            made = pair(place, scene=scene)
            matchers = {"ours": Exact(made, 1.0, 0.8), "other": Exact(made, 0.5, 0.2)}
            scores += measure_pair(made, matchers)
    better = against(scores, "ours", "other", "3 on", 0)
    assert better is not None and better.verdict == "better"
    assert better.ratio == pytest.approx(0.5, abs=0.03)
    kept = retained_against(scores, "ours", "other", "night")
    assert kept is not None and kept.ratio == pytest.approx(0.5, abs=0.03)
    assert against(scores, "ours", "other", "eyes", 0) is None
    checks = match_table.requirements(scores, ["other"])
    assert checks and all(check.passed for check in checks)
    assert not any(check.passed for check in match_table.requirements(_swapped(scores), ["other"]))


def _swapped(scores):
    from dataclasses import replace

    names = {"ours": "other", "other": "ours"}
    return [replace(score, matcher=names[score.matcher]) for score in scores]


def test_a_table_row_has_the_shares_in_percent():
    made = pair(0, case="1 on")
    (row,) = rows(measure_pair(made, {"KLT": KltMatcher()}))
    figures = dict(zip(COLUMNS, row, strict=True))
    assert figures["pictures"] == "clean" and figures["matcher"] == "KLT"
    assert 80 < figures["1 px %"] <= figures["3 px %"] <= 100
    assert figures["error / sigma"] is None and figures["error px"] < 0.3


def test_pictures_without_texture_are_not_counted():
    made = pair(0)
    blank = Side(np.full_like(made.a.image, 80), made.a.truth, 0)
    assert measure_pair(Pair("3 on", "x", 0, blank, blank), {"KLT": KltMatcher()}) == []
