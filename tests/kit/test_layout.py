from dataclasses import replace

import numpy as np
import pytest

from calm_edge.geometry import pinhole, se3
from calm_edge.kit import layout


def test_a_hint_sets_the_focal_of_its_eye_and_how_sure_it_is():
    belief = layout.prior((90.0, None))
    sigma = np.diag(belief.information) ** -0.5
    assert np.exp(belief.mean[0]) == pytest.approx(0.5)
    assert np.exp(belief.mean[4]) == pytest.approx(0.5 / np.tan(np.radians(73 / 2)))
    assert sigma[0] == pytest.approx(0.01) and sigma[4] == pytest.approx(0.30)
    # a hint is of the focal only
    assert np.array_equal(np.delete(belief.mean, [0, 4]), np.zeros(layout.SIZE - 2))
    assert sigma[1] == sigma[5] and (sigma[layout.RIG] >= 0.5).all()


def test_the_camera_matrix_of_a_hint_is_the_pinholes():
    theta = layout.prior((81.0, 64.0)).mean
    for eye, hfov, size in ((0, 81.0, (640, 240)), (1, 64.0, (480, 200))):
        assert np.allclose(layout.camera_matrix(theta, eye, *size), pinhole.from_hfov(hfov, *size))


def test_the_principal_point_is_a_share_of_the_width_from_the_middle():
    theta = layout.prior((None, None)).mean
    theta[[5, 6]] = 0.01, -0.02
    K = layout.camera_matrix(theta, 1, 480, 200)
    assert K[:2, 2] == pytest.approx([239.5 + 4.8, 99.5 - 9.6])
    assert layout.camera_matrix(theta, 0, 480, 200)[:2, 2] == pytest.approx([239.5, 99.5])


def test_the_rig_there_and_back():
    theta = layout.prior((None, None)).mean
    theta[layout.RIG] = [0.1, -0.7, 0.2, 0.48, -0.6, 0.64]
    assert np.allclose(layout.rig_vector(layout.rig(theta)), theta[layout.RIG])
    # the translation is the assistant's centre in the primary's axes
    assert np.allclose(se3.transform(layout.rig(theta), np.zeros(3)), [0.48, -0.6, 0.64])


def test_a_rig_of_any_length_becomes_one_spacing():
    T_p_a = se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.0])), np.array([3.0, 0.0, 4.0]))
    assert np.allclose(layout.rig_vector(T_p_a), [0, 0.1, 0, 0.6, 0, 0.8])


def test_a_window_off_the_kits_lateness_blurs_that_and_nothing_else():
    belief = layout.prior((None, None))
    rng = np.random.default_rng(0)
    mixed = belief.information + 1e4 * np.cov(rng.normal(size=(layout.SIZE, 40)))
    blurred = layout.blurred(replace(belief, information=mixed), 0.002)
    more = np.linalg.inv(blurred.information) - np.linalg.inv(mixed)
    where = np.zeros((layout.SIZE, layout.SIZE))
    where[layout.LATE, layout.LATE] = 1
    assert np.allclose(more, 0.002**2 * where, atol=1e-10)
    assert np.array_equal(blurred.mean, belief.mean)
    # evidence that is silent on some of the kit has no covariance
    silent = replace(belief, information=np.diag(1e8 * (np.arange(layout.SIZE) == layout.LATE)))
    assert layout.blurred(silent, 0.002).information[layout.LATE, layout.LATE] == pytest.approx(
        1 / (1e-8 + 0.002**2)
    )
    assert layout.blurred(belief, 0.0) is belief
