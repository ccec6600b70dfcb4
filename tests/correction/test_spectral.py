from dataclasses import replace

import numpy as np
import pytest

from bench.scripted.motions import CAMERA, group, motion
from calm_edge.correction import spectral
from calm_edge.geometry import epipolar, se3

FOCALS = 700 * np.array([0.7, 0.85, 1.0, 1.15, 1.3])


def pairs(kind):
    """Exact F (P, 3, 3) of each view and the fourth one after it."""
    T = motion(kind)
    return epipolar.from_motion(CAMERA, CAMERA, se3.inverse(T[4:]) @ T[:-4])


def test_the_score_equals_the_equation():
    rng = np.random.default_rng(0)
    F, skewed = rng.normal(size=(50, 3, 3)), CAMERA.matrix
    skewed[0, 1], skewed[1, 1] = 3.0, 650
    s = np.linalg.svd(skewed.T @ F @ skewed, compute_uv=False)
    expected = (np.abs(s[:, 0] - s[:, 1]) + s[:, 2]) / s[:, 0]
    assert spectral.score(skewed, F) == pytest.approx(expected, abs=1e-6)
    many = spectral.score(np.stack([CAMERA.matrix, skewed]), F)
    assert many.shape == (2, 50) and many[1] == pytest.approx(expected, abs=1e-6)


def test_the_true_focal_has_score_zero_and_others_do_not_in_a_turn():
    score = spectral.score_at(CAMERA, FOCALS, pairs("general")).mean(-1)
    assert score.argmin() == 2 and score[2] < 1e-6
    assert score[[1, 3]].min() > 1e-3


@pytest.mark.parametrize("kind", ["straight", "tangent"])
def test_on_a_straight_and_a_tangent_arc_all_focals_have_score_zero(kind):
    assert spectral.score_at(CAMERA, FOCALS, pairs(kind)).max() < 1e-6


def test_ahead_of_the_axle_five_percent_error_has_a_small_score():
    score = spectral.score_at(CAMERA, np.array([665.0, 700, 735]), pairs("ahead"))
    assert 1e-4 < score.mean(-1)[[0, 2]].max() < 5e-3


def test_at_focal_keeps_aspect_ratio_and_principal_point():
    shape = replace(CAMERA, fx=600.0, fy=660.0)
    expected = replace(CAMERA, fx=300.0, fy=330.0).matrix
    assert spectral.at_focal(shape, 300.0) == pytest.approx(expected)


@pytest.mark.parametrize("kind", ["straight", "tangent"])
def test_uninformative_motions_have_almost_no_information(kind):
    total = spectral.information(group(kind, 1).sensitivity, np.log(700)).sum()
    yawed = group("yawed", 1).sensitivity
    assert total < 1e-3 * spectral.information(yawed, np.log(700)).sum()


def test_information_is_the_squared_slope_over_the_noise():
    sensitivity = group("general", 2).sensitivity
    slope, noise, _, across, down = sensitivity.at(np.log(700))
    unswayed = slope**2 / (noise**2 + across**2 + down**2)
    information = spectral.information(sensitivity, np.log(700))
    counted = information > 0
    assert counted.mean() > 0.9
    assert information[counted] == pytest.approx(unswayed[counted], rel=0.05)
    assert (spectral.information(sensitivity, np.log(700), 0.05) <= information).all()


def test_twice_the_noise_is_a_quarter_of_the_information():
    def of_matches(noise_px):
        slope, noise, *_ = group("general", 3, noise_px=noise_px).sensitivity.at(np.log(700))
        return np.median(slope / noise) ** 2

    assert of_matches(0.2) / of_matches(0.4) == pytest.approx(4, rel=0.35)


def test_the_principal_point_shifts_the_focal_oppositely_in_opposite_turns():
    def shift(kind):
        sensitivity = group(kind, 4).sensitivity
        weight = spectral.information(sensitivity, np.log(700))
        return (weight @ spectral.centre_shift(sensitivity, np.log(700)))[0] / weight.sum()

    right, left = shift("ahead"), shift("-ahead")
    assert right * left < 0 and abs(right) > 0.03
    assert right == pytest.approx(-left, rel=0.2)


def test_the_centre_shift_predicts_the_minimum():
    sigma_px = spectral.PRINCIPAL_POINT_SHARE * 2 * CAMERA.cx
    F = pairs("ahead")
    focals = np.array([500.0, 700, 900])
    sensitivity = spectral.focal_sensitivity(CAMERA, F, np.zeros((len(F), 7, 3, 3)), focals)
    expected = spectral.centre_shift(sensitivity, np.log(700))[:, 0].mean()
    aside = replace(CAMERA, cx=CAMERA.cx + 0.2 * sigma_px)
    focals = 700 * np.exp(np.linspace(-0.1, 0.1, 201))
    score = spectral.score_at(aside, focals, F).mean(-1)
    assert np.log(focals[score.argmin()] / 700) == pytest.approx(0.2 * expected, rel=0.15)
