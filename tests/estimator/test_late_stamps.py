from dataclasses import replace

import numpy as np
import pytest

from calm_edge.estimator.late_stamps import LateStampsEstimator, Views
from calm_edge.geometry import se3

T_P_A = se3.exp(np.array([0.55, 0.03, 0.05, 0.02, 0.07, -0.01]))
NOISE_RAD = 1e-3
RAYS = np.array([[-0.6, 0.0, 0.8], [0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
FRAMES_HZ = 10.0


def path(yaw_rate, seconds):
    """T_w_p of a car at 8 m/s, at 100 Hz, with a yaw rate [rad/s] that is a function of time."""
    t = np.arange(-1.0, seconds + 1.0, 0.01)
    step = np.zeros((len(t) - 1, 6))
    step[:, 2], step[:, 4] = 0.08, 0.01 * yaw_rate(t[:-1])
    T = [np.eye(4)]
    for xi in se3.exp(step):
        T.append(T[-1] @ xi)
    return t, np.stack(T)


def windows(yaw_rate, late_s, drift=0.0, *, seed=0, seconds=12.0, noise=NOISE_RAD):
    """Windows of 15 keyframes of each eye with equal stamps, exposed late_s after these."""
    rng = np.random.default_rng(seed)
    t, T_w_p = path(yaw_rate, seconds)
    out = []
    for start in np.arange(0.0, seconds - 1.5, 1.2):
        stamps = start + np.arange(15) / FRAMES_HZ
        exposed = stamps + late_s + drift * (stamps - seconds / 2)
        T_p = se3.interpolate_at(t, T_w_p, stamps)
        T_a = se3.interpolate_at(t, T_w_p, exposed) @ T_P_A
        shaken = [
            T @ se3.exp(np.c_[0.01 * rng.normal(size=(15, 3)), noise * rng.normal(size=(15, 3))])
            for T in (T_p, T_a)
        ]
        out.append(Views(stamps, shaken[0], stamps, shaken[1], RAYS))
    return out


def estimated(views):
    estimator = LateStampsEstimator()
    for each in views:
        estimator.add(each)
    return estimator.result


def town(t):
    """Turns of up to 15 deg/s."""
    return 0.25 * np.sin(2 * np.pi * t / 7.0)


def straight(t):
    return np.zeros_like(t)


@pytest.mark.parametrize("late_s", [-0.4, -0.2, -0.1, -0.05, 0.05, 0.1, 0.2, 0.4])
def test_turns_show_an_offset_of_either_sign(late_s):
    found = estimated(windows(town, late_s))
    assert found.found and not found.drifts
    assert found.offset_s == pytest.approx(late_s, abs=3 * found.sigma_s)


@pytest.mark.parametrize("drift", [0.01, -0.01])
def test_turns_show_a_drift(drift):
    found = estimated(windows(town, 0.02, drift))
    assert found.drifts
    assert found.drift == pytest.approx(drift, abs=4 * found.drift_sigma)
    stamps = np.array([1.0, 6.0, 11.0])
    assert np.allclose(found.at(stamps), 0.02 + drift * (stamps - 6.0), atol=0.015)


@pytest.mark.parametrize("late_s", [-0.4, 0.0, 0.2])
def test_a_straight_road_shows_nothing(late_s):
    for seed in range(3):
        found = estimated(windows(straight, late_s, seed=seed))
        assert not found.significant
        assert found.sigma_s > 0.02


@pytest.mark.parametrize("degrees_per_s", [2.0, 6.0, 15.0])
def test_right_stamps_are_not_suspected_and_the_sigma_holds(degrees_per_s):
    def bends(t):
        return np.radians(degrees_per_s) * np.sin(2 * np.pi * t / 6.0)

    found = [estimated(windows(bends, 0.0, seed=seed, seconds=8.0)) for seed in range(8)]
    assert not any(each.significant for each in found)
    normalised = np.array([each.offset_s / each.sigma_s for each in found])
    # the rms of eight has a sigma of 25 %; that of a sigma half as large as it should be is two
    assert np.sqrt((normalised**2).mean()) < 1.3


def test_windows_with_wrong_poses_do_not_spoil_the_estimate():
    views = windows(town, 0.2)
    rng = np.random.default_rng(9)
    for k in (2, 5):
        spoilt = views[k].T_s_a @ se3.exp(0.2 * rng.normal(size=(15, 6)))
        views[k] = replace(views[k], T_s_a=spoilt)
    found = estimated(views)
    assert found.found and found.offset_s == pytest.approx(0.2, abs=3 * found.sigma_s)


@pytest.mark.parametrize(("turned_rad", "remembered"), [(0.02, True), (0.1, False)])
def test_windows_solved_with_another_lens_are_forgotten(turned_rad, remembered):
    """Right stamps; the rig of the first windows is turned by a wrong lens, as it is not later."""
    views = windows(town, 0.0, seconds=8.0)
    turn = se3.exp(np.array([0, 0, 0, 0, turned_rad, 0]))
    rays = RAYS @ turn[:3, :3].T
    early = [replace(each, T_s_a=each.T_s_a @ turn, rays=rays) for each in views[:3]]
    alone, after = estimated(views[3:]), estimated([*early, *views[3:]])
    assert (alone.offset_s != after.offset_s) == remembered


def test_nothing_is_known_before_the_first_window():
    assert not LateStampsEstimator().result.significant
