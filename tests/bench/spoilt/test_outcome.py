"""Judgement on what came of a spoilt drive."""

import math
from subprocess import CompletedProcess

import pytest

from bench.spoilt.outcome import Spoilt, last_said

PROGRESS = "calm-edge: finishing: 1 windows left to solve\n"


def _spoilt(**changes):
    values = {
        "drive": "demo", "case": "offset04", "exit_code": 0, "said": "", "path_m": 41.0,
        "true_m": 41.6, "scale_sigma": 0.01, "states": ("RUNNING",), "live": 60, "lost": 0,
        "odometry": 60, "quality": 100,
    }  # fmt: skip
    return Spoilt(**values | changes)


@pytest.mark.parametrize(
    ("changes", "right"),
    [
        ({}, True),
        ({"path_m": 7.7}, False),
        ({"path_m": 7.7, "scale_sigma": None}, False),
        ({"path_m": 40.0, "scale_sigma": None}, True),
        ({"path_m": 30.0, "scale_sigma": 0.2}, True),
        ({"path_m": 39.5, "truth_log_sigma": 0.03}, True),
        # no metre: exit code 3, and nothing for the autopilot
        ({"path_m": 7.7, "exit_code": 3, "odometry": 0, "scale_sigma": math.inf}, True),
        ({"path_m": 7.7, "exit_code": 3, "odometry": 5}, False),
        ({"exit_code": 1, "odometry": 0}, False),
        # a parked car
        ({"true_m": 0.0, "path_m": 0.05}, True),
        ({"true_m": 0.0, "path_m": 37.0}, False),
    ],
)
def test_a_metre_is_right_or_not_claimed(changes, right):
    assert _spoilt(**changes).right is right


@pytest.mark.parametrize(
    ("stderr", "said"),
    [
        (f"calm-edge: no metre\n{PROGRESS}", "calm-edge: no metre"),
        (PROGRESS, "live poses  0"),
        ("", "live poses  0"),
    ],
)
def test_progress_is_not_the_last_word(stderr, said):
    assert last_said(CompletedProcess([], 0, "recording  r\nlive poses  0\n", stderr)) == said
