"""Sigma of the scale that a recording claims."""

import math
from dataclasses import replace

import pytest

from bench.claimed import axes_sigma, scale_sigma
from calm_edge.kit import layout
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


def test_the_axes_are_known_as_well_as_the_principal_point():
    """The prior of a kit of 90 degrees: a principal point known to 0.02 of the width."""
    one = replace(update(curve(4), stamps(4)), kit=layout.prior((90.0, 90.0)))
    assert axes_sigma([one]) == pytest.approx((0.04, 0.04))
    assert axes_sigma([replace(one, kit=None)]) is None and axes_sigma([]) is None
