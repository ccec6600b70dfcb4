from dataclasses import replace

import numpy as np
import pytest

from calm_edge.estimator import metre
from calm_edge.estimator.metre import DriveMetre
from calm_edge.types import METRIC_LOG_SIGMA, Submap

SPACING = 0.5
N = 5


def submap(step, sigma):
    """A sub-map whose primary moves by `step` metres between keyframes."""
    T = np.tile(np.eye(4), (N, 1, 1))
    T[:, 2, 3] = step * np.arange(N)
    ids, t_ns = tuple(range(N)), 1000 * np.arange(N)
    return Submap(
        0, ids, (), 0, t_ns, T, (), T, (), 1.0, np.eye(4), np.zeros(2), scale_log_sigma=sigma
    )


def test_a_longer_submap_counts_more():
    short, long = submap(1.0, 0.09), submap(3.0, 0.01)
    held = DriveMetre(SPACING).of([short, long])
    assert held.log_sigma == pytest.approx((0.09 + 3 * 0.01) / 4)
    assert held.metric and held.reason == ""


@pytest.mark.parametrize("sigma", [2 * METRIC_LOG_SIGMA, np.inf])
def test_an_unknown_scale_has_a_reason_and_no_more_than_the_length_itself_as_sigma(sigma):
    held = DriveMetre(SPACING).of([submap(1.0, sigma)])
    assert not held.metric and held.reason == metre.NO_PARALLAX
    assert held.log_sigma == pytest.approx(min(sigma, 1.0))


def test_an_unknown_focal_is_named_as_the_cause():
    straight = replace(submap(1.0, 0.2), focal_log_sigma=np.array([0.2, 0.2]))
    assert DriveMetre(SPACING).of([straight]).reason == metre.NO_FOCAL


def test_a_standing_car_and_no_submap():
    drive = DriveMetre(SPACING)
    assert drive.of([]).reason == metre.NO_WINDOW
    assert drive.of([submap(0.01, 0.01)] * 3).reason == metre.STOOD


def test_a_path_that_leads_nowhere_is_that_of_a_standing_car():
    noise = submap(1.0, np.inf)
    noise.T_s_c[:, 2, 3] = 3.0 * (np.arange(N) % 2)
    assert DriveMetre(SPACING).of([noise] * 3).reason == metre.STOOD


def test_an_objection_holds_until_it_is_withdrawn():
    drive, good = DriveMetre(SPACING), [submap(1.0, 0.01)]
    drive.object_to("pictures", "both pictures look alike")
    assert not drive.of(good).metric and drive.of(good).reason == "both pictures look alike"
    drive.object_to("pictures", None)
    assert drive.of(good).metric
