from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import starts
from calm_edge.backbones.bundle.backbone import FAMILIES
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.kit.lens import Family
from calm_edge.types import KitBelief
from tests.backbones.bundle.exact_window import theta_of, turn, window

N = 8
PRIOR = layout.prior((None, None))


@pytest.fixture(scope="module")
def made():
    return window(turn(N), theta_of(), noise_px=0.3, outliers=0.05)


def known(made, **others):
    """Nothing known but the prior, unless given."""
    return replace(
        starts.Known((PRIOR,), (), focal_sigma=0.3, rig=False, all=False, travel=None), **others
    )


def exact_kit(made):
    return KitBelief(made.truth.theta, 1e4 * np.eye(layout.SIZE))


def test_the_first_is_near_the_truth_and_all_have_all_points(made):
    states = list(starts.initial_states(made.m, made.ties, known(made)))
    assert all(len(state.points) == len(made.truth.points) for state in states)
    off = se3.log(se3.inverse(made.truth.T_c_s) @ states[0].T_c_s)[:, 3:]
    assert np.degrees(np.linalg.norm(off, axis=1)).max() < 3
    assert np.abs(states[0].theta - made.truth.theta)[layout.LOG_FOCAL].max() < 0.1


def test_none_is_taken_because_it_is_the_only_one(made, monkeypatch):
    tried = []

    def trial(m, ties, kit, poses, start):
        tried.append(start)
        return float(len(tried)), start

    monkeypatch.setattr(starts, "_trial", trial)
    sure = known(made, kits=(exact_kit(made),), focal_sigma=0.01, rig=True, all=True)
    # a first path of the lowest cost does not end the search
    monkeypatch.setattr(starts, "GOOD_START", 100.0)
    assert len(list(starts.initial_states(made.m, made.ties, sure))) == 2
    # with no good one all paths are tried, the cheapest first
    tried.clear()
    monkeypatch.setattr(starts, "GOOD_START", 0.0)
    states = list(starts.initial_states(made.m, made.ties, sure))
    assert len(states) == 2 + len(starts.SEED_SHARES)
    assert all(
        np.array_equal(state.T_c_s, start.T_c_s) for state, start in zip(states, tried, strict=True)
    )


def test_after_a_solved_window_the_first_path_comes_alone_and_before_all_others(made, monkeypatch):
    tried = []

    def trial(m, ties, kit, poses, start):
        tried.append(start)
        return float(-len(tried)), start

    monkeypatch.setattr(starts, "_trial", trial)
    sure = known(made, kits=(exact_kit(made),), focal_sigma=0.01, rig=True, all=True, follows=True)
    states = starts.initial_states(made.m, made.ties, sure)
    first = next(states)
    assert len(tried) == 1
    assert np.array_equal(first.T_c_s, tried[0].T_c_s)
    rest = list(states)
    assert len(rest) == len(tried) - 1 >= starts.ENOUGH_PATHS
    assert np.array_equal(rest[0].T_c_s, tried[-1].T_c_s)


@pytest.mark.parametrize("families", FAMILIES)
def test_the_cheapest_start_has_lenses_of_the_true_families(families):
    theta = theta_of()
    wide = np.array(families) == Family.FISHEYE
    theta[layout.FAMILY] = families
    theta[layout.LOG_FOCAL[wide]] = np.log(0.48)
    theta[layout.DISTORTION[wide]] = 0.01, -0.004
    theta[layout.DISTORTION[~wide]] = -0.1, 0.03
    # as wide pictures show: points far off the axis
    made = window(turn(5), theta, n_points=400, noise_px=0.3, wide=2.0)
    kits = [layout.prior((None, None), families=each) for each in FAMILIES]
    first = next(starts.initial_states(made.m, made.ties, known(made, kits=kits)))
    assert layout.families(first.theta) == families
    assert np.abs(first.theta - theta)[layout.LOG_FOCAL].max() < 0.1


def test_without_matches_between_the_eyes_it_raises(made):
    rows = made.m.eye[made.m.view] == 0
    m = replace(
        made.m, **{k: getattr(made.m, k)[rows] for k in ("view", "point", "uv", "sigma_px")}
    )
    with pytest.raises(BackboneError, match="no matches between the cameras"):
        list(starts.initial_states(m, made.ties, known(made)))
