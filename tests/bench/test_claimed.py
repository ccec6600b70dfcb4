"""Sigma of the scale that a recording claims."""

import math
from dataclasses import replace

import numpy as np
import pytest

from bench.claimed import scale_history, scale_sigma
from calm_edge.types import Metre
from tests.evaluation.worlds import curve, stamps, update


@pytest.mark.parametrize(
    ("metre", "sigma"),
    [
        (Metre(0.02), 0.02),
        (Metre(math.inf, "the car stood still"), math.inf),
        (Metre(0.5, "no parallax"), 0.5),
        # as an older version's recording is read
        (Metre(), None),
    ],
)
def test_an_unknown_sigma_is_not_one_that_is_not_reported(metre, sigma):
    first = replace(update(curve(4), stamps(4)), metre=Metre(0.3, "no parallax"))
    assert scale_sigma([first, replace(first, metre=metre)]) == sigma


def test_without_a_sub_map_nothing_is_claimed():
    assert scale_sigma([]) is None


def _update(submap_id, last_ns, metre):
    whole = update(curve(4), stamps(4), submap_id=submap_id)
    submap = replace(whole.submap, t_ns=np.array([0, last_ns, 0]))
    return replace(whole, submap=submap, metre=metre)


def test_during_the_drive_the_sigma_is_the_one_claimed_then():
    early, late, final = Metre(math.inf, "no parallax"), Metre(0.05), Metre(0.01)
    updates = [_update(0, 100, early), _update(1, 200, late), _update(0, 100, final)]
    history = scale_history(updates)
    stamps_ns = np.array([50, 100, 150, 200, 999])
    assert history.at(stamps_ns).tolist() == [math.inf, math.inf, math.inf, 0.05, 0.05]


def test_a_version_without_a_metre_claims_the_covariances_alone():
    assert scale_history([_update(0, 100, Metre())]).at(np.array([100])).tolist() == [0.0]
