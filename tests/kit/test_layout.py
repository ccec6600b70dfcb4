from dataclasses import replace

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.kit import layout
from calm_edge.kit.lens import Family


def test_names_cover_the_vector_once():
    terms = [layout.LOG_FOCAL, layout.PRINCIPAL_POINT.ravel(), layout.DISTORTION.ravel()]
    single = layout.RIG_ROTATION, layout.RIG_CENTRE, layout.TIME_OFFSET, layout.FAMILY
    entries = np.r_[(*terms, layout.READOUT, *single)]
    assert np.array_equal(np.sort(entries), np.arange(layout.SIZE))
    assert np.array_equal(np.sort(np.concatenate(terms)), np.sort(layout.OPTICS.ravel()))
    assert np.array_equal(np.r_[layout.RIG_ROTATION, layout.RIG_CENTRE], np.r_[layout.RIG])


def test_drift_and_prior_are_set_for_every_term():
    sigma = np.diag(layout.prior((None, None)).information) ** -0.5
    drift = layout.drift_sigma()
    for vector in (sigma, drift):
        assert np.isfinite(vector).all() and (vector > 0).all()
        assert np.array_equal(vector[layout.OPTICS[0]], vector[layout.OPTICS[1]])
    # except for the time offset, a drive starts from the belief of the last one
    assert (np.delete(drift < sigma, layout.TIME_OFFSET)).all() and drift[layout.TIME_OFFSET] == 1.0


def test_the_second_radial_term_is_expected_to_bend_back():
    covariance = np.linalg.inv(layout.prior((None, None)).information)
    for k1, k2 in layout.DISTORTION:
        assert covariance[k1, k1] == pytest.approx(0.15**2)
        assert covariance[k1, k2] / covariance[k1, k1] == pytest.approx(-0.25)
        assert covariance[k2, k2] == pytest.approx(0.05**2 + (0.25 * 0.15) ** 2)


def test_a_hint_sets_the_focal_of_its_eye_and_its_sigma():
    belief = layout.prior((90.0, None))
    sigma = np.diag(belief.information) ** -0.5
    expected = [0.5, 0.5 / np.tan(np.radians(73 / 2))]
    assert np.exp(belief.mean[layout.LOG_FOCAL]) == pytest.approx(expected)
    assert sigma[layout.LOG_FOCAL] == pytest.approx([0.01, 0.30])
    # a hint concerns the focal only
    others = np.delete(belief.mean, layout.LOG_FOCAL)
    unhinted = np.delete(layout.prior((None, None)).mean, layout.LOG_FOCAL)
    assert np.array_equal(others, unhinted)
    assert np.count_nonzero(unhinted) == 2  # the readout times
    assert np.ptp(sigma[layout.PRINCIPAL_POINT]) == 0 and (sigma[layout.RIG] >= 0.5).all()


def test_a_hint_sets_the_readout_of_its_eye_and_its_sigma():
    belief = layout.prior((None, None), readout_s=(None, 0.025))
    sigma = np.diag(belief.information) ** -0.5
    assert belief.mean[layout.READOUT] == pytest.approx([layout.READOUT_S, 0.025])
    assert sigma[layout.READOUT] == pytest.approx([0.012, 0.0005])


def test_the_camera_of_a_hint_is_a_pinhole_of_that_field():
    theta = layout.prior((81.0, 64.0)).mean
    for eye, hfov, size in ((0, 81.0, (640, 240)), (1, 64.0, (480, 200))):
        made, expected = layout.camera(theta, eye, *size), Perspective.from_hfov(hfov, *size)
        assert np.allclose(made.matrix, expected.matrix) and made.is_pinhole
        assert (made.width, made.height) == size


def test_lenses_of_either_family_have_their_own_priors():
    families = Family.FISHEYE, Family.PERSPECTIVE
    belief = layout.prior((None, None), families=families)
    assert layout.families(belief.mean) == families
    wide, narrow = layout.cameras(belief.mean, np.array([[640, 360], [640, 360]]))
    assert type(wide) is Fisheye and type(narrow) is Perspective
    # 125 degrees across, and half a degree more by the lens's terms
    left, right = wide.rays(np.array([[-0.5, 179.5], [639.5, 179.5]]))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(125, abs=4)
    sigma = np.sqrt(np.diag(np.linalg.inv(belief.information)))
    assert sigma[layout.DISTORTION[0]] == pytest.approx([0.08, 0.03])
    assert sigma[layout.LOG_FOCAL] == pytest.approx([0.25, 0.30])
    hinted = layout.camera(layout.prior((120.0, None), families=families).mean, 0, 640, 360)
    assert hinted.fx == pytest.approx(320 / np.radians(60))


def test_beliefs_of_other_lenses_are_not_alike():
    one, other = (layout.prior((None, None), families=(f, Family.PERSPECTIVE)) for f in Family)
    assert layout.alike(one, one) and not layout.alike(one, other)


def test_the_principal_point_is_a_share_of_the_width_from_the_centre():
    theta = layout.prior((None, None)).mean
    theta[layout.PRINCIPAL_POINT[1]] = 0.01, -0.02
    there, middle = layout.cameras(theta, np.array([[480, 200], [480, 200]]))[::-1]
    assert (there.cx, there.cy) == pytest.approx([239.5 + 4.8, 99.5 - 9.6])
    assert (middle.cx, middle.cy) == pytest.approx([239.5, 99.5])


def test_the_rig_round_trips():
    theta = layout.prior((None, None)).mean
    theta[layout.RIG] = [0.1, -0.7, 0.2, 0.48, -0.6, 0.64]
    assert np.allclose(layout.rig_vector(layout.rig(theta)), theta[layout.RIG])
    # the translation is the assistant's centre in the primary's axes
    assert np.allclose(se3.transform(layout.rig(theta), np.zeros(3)), [0.48, -0.6, 0.64])


def test_a_rig_of_any_length_is_scaled_to_one_spacing():
    T_p_a = se3.compose(se3.so3_exp(np.array([0.0, 0.1, 0.0])), np.array([3.0, 0.0, 4.0]))
    assert np.allclose(layout.rig_vector(T_p_a), [0, 0.1, 0, 0.6, 0, 0.8])


def test_time_jitter_adds_variance_to_the_time_offset_only():
    belief = layout.prior((None, None))
    rng = np.random.default_rng(0)
    mixed = belief.information + 1e4 * np.cov(rng.normal(size=(layout.SIZE, 40)))
    blurred = layout.with_time_jitter(replace(belief, information=mixed), 0.002)
    more = np.linalg.inv(blurred.information) - np.linalg.inv(mixed)
    where = np.zeros((layout.SIZE, layout.SIZE))
    where[layout.TIME_OFFSET, layout.TIME_OFFSET] = 1
    assert np.allclose(more, 0.002**2 * where, atol=1e-10)
    assert np.array_equal(blurred.mean, belief.mean)
    # singular evidence has no covariance
    silent = replace(
        belief, information=np.diag(1e8 * (np.arange(layout.SIZE) == layout.TIME_OFFSET))
    )
    assert layout.with_time_jitter(silent, 0.002).information[
        layout.TIME_OFFSET, layout.TIME_OFFSET
    ] == pytest.approx(1 / (1e-8 + 0.002**2))
    assert layout.with_time_jitter(belief, 0.0) is belief


def test_an_unknown_field_of_view_is_that_of_the_long_side():
    upright, lying = (np.tile([size], (2, 1)) for size in [(208, 544), (544, 208)])
    focals = [np.exp(layout.prior((None, None), s).mean[layout.LOG_FOCAL]) * s[0, 0]
              for s in (upright, lying)]  # fmt: skip
    assert focals[0] == pytest.approx(focals[1])
    hinted = layout.prior((90.0, 90.0), upright).mean[layout.LOG_FOCAL]
    assert np.exp(hinted) == pytest.approx([0.5, 0.5])
