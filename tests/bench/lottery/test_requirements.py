"""What is asked of the lottery's drives: met by good ones, missed by each fault alone."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from bench.lottery.requirements import LIMITS, requirements
from bench.outcome import Outcome

# Quantiles of a normal distribution: errors as their sigmas say, without the luck of a draw.
UNIT = norm.ppf((np.arange(40) + 0.5) / 40)


def _good(unit):
    """A drive whose errors are `unit` sigmas."""
    focal, scale = (0.01 * unit, -0.01 * unit), math.exp(-0.005 * unit)
    return Outcome("d", 100.0, 30.0, 0.2, 0.1, scale, 0.005, 0.99, 0.0, focal, (0.01, 0.01))


GOOD = [_good(unit) for unit in UNIT.tolist()]


def _missed(found, kind="plain"):
    missed = [check.what for check in requirements(found, LIMITS[kind]) if not check.passed]
    return {what.split(":")[0].split(",")[0] for what in missed}


def test_honest_drives_meet_every_requirement():
    assert _missed(GOOD) == set()


@pytest.mark.parametrize(
    ("fault", "missed"),
    [
        ({"garbage": 0.05}, "garbage steps"),
        ({"garbage_of_metric": 0.05}, "garbage steps"),
        ({"placed": 0.1}, "keyframes neither lost nor bridged"),
        ({"ate_percent": 2.0}, "focals observed"),
        ({"yaw_deg": 1.0}, "focals called observed with less than 2 degrees and no hint"),
        ({"focal_error": (0.06, 0.0)}, "observed focals"),
        ({"scale": 1.04}, "scale of a drive"),
    ],
)
def test_one_bad_drive_in_forty_is_seen(fault, missed):
    found = [replace(GOOD[0], **fault), *GOOD[1:]]
    assert missed in _missed(found)


def test_a_drive_without_a_result_counts_as_garbage_and_an_infinite_error():
    failed = Outcome("d", 100.0, 30.0, failed="too dark")
    checks = {
        check.what: check for check in requirements([failed, failed, GOOD[0]], LIMITS["plain"])
    }
    assert checks["garbage steps, of keyframes not said to be lost, %"].measured > 60
    assert checks["all drives: median ATE, %"].measured == math.inf
    assert not checks["focals called observed with more than 15 degrees of yaw, %"].passed


def test_a_scale_without_a_sigma_meets_no_requirement():
    found = [replace(one, scale_sigma=None) for one in GOOD]
    assert _missed(found) == {"scale of a drive"}


def test_less_is_asked_of_real_drives():
    found = [replace(one, placed=0.96, garbage=0.004) for one in GOOD]
    assert _missed(found, "real") == set()
    assert _missed(found) == {"garbage steps", "keyframes neither lost nor bridged"}
