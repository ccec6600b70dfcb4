import numpy as np
import pytest

from calm_edge.config import CalibratedCameraConfig, CalibrationConfig, Config, ConfigError, merge
from calm_edge.geometry.camera import Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.kit import layout
from calm_edge.kit.belief import covariance, product
from calm_edge.kit.calibration import (
    camera_of,
    described,
    lens_prior,
    matched,
    optics_belief,
    rig_belief,
    sampled,
)

SIZES = np.array([[1280, 720], [640, 480]])
PRIMARY = CalibratedCameraConfig("perspective", 812.0, 812.0, 655.0, 350.0, 1280, 720, (-0.05,))
WIDE = CalibratedCameraConfig("fisheye", 250.0, 251.0, 322.0, 238.0, 640, 480, (0.01, -0.002))
CAMERA = Perspective(1000.0, 1002.0, 951.0, 545.0, 1920, 1080, (-0.3, 0.1))


def test_pictures_of_the_same_size_are_taken_as_they_are():
    assert matched(CAMERA, 1920, 1080) == (CAMERA, "")


def test_a_smaller_picture_of_the_same_shape_is_scaled_with_a_sentence():
    camera, said = matched(CAMERA, 1280, 720)
    ray = np.array([0.3, -0.2, 1.0])
    # pixel centres: the corner (-0.5, -0.5) stays
    assert np.allclose(camera.project(ray) + 0.5, (CAMERA.project(ray) + 0.5) / 1.5)
    assert "1920 x 1080" in said and "1280 x 720" in said and "scaled" in said


@pytest.mark.parametrize("size", [(1280, 960), (1440, 1080), (1080, 1920)])
def test_a_cropped_picture_is_refused_with_the_reason(size):
    camera, reason = matched(CAMERA, *size)
    assert camera is None and "cropped" in reason and f"{size[0]} x {size[1]}" in reason


def rms_px(theta, eye, camera):
    rays, uv = sampled(camera)
    off = layout.camera(theta, eye, camera.width, camera.height).project(rays) - uv
    return np.sqrt((off**2).sum(1).mean())


@pytest.mark.parametrize("sigma_px", [0.5, 2.0])
def test_a_draw_from_the_prior_is_off_by_its_sigma_over_the_picture(sigma_px):
    camera = camera_of(PRIMARY)
    lens, theta = lens_prior(camera, 0, sigma_px), layout.prior((None, None)).mean.copy()
    theta[layout.OPTICS[0]] = lens.mean
    assert lens.off_px < 1e-6 and rms_px(theta, 0, camera) < 1e-6
    draws = np.random.default_rng(0).multivariate_normal(
        lens.mean, np.linalg.inv(lens.information), 400
    )
    off = []
    for draw in draws:
        theta[layout.OPTICS[0]] = draw
        off.append(rms_px(theta, 0, camera) ** 2)
    assert np.sqrt(np.mean(off)) == pytest.approx(sigma_px, rel=0.1)


def test_a_lens_with_more_terms_than_the_kit_is_less_certain():
    exact = lens_prior(camera_of(PRIMARY), 0, 1.0)
    many = Perspective(812.0, 830.0, 655.0, 350.0, 1280, 720, (-0.05, 0.0, 0.003, -0.002))
    fitted = lens_prior(many, 0, 1.0)
    assert fitted.off_px > 1.0
    ratio = np.sqrt(exact.information[0, 0] / fitted.information[0, 0])
    assert ratio == pytest.approx(np.hypot(1.0, fitted.off_px), rel=0.05)


def test_a_wide_lens_outside_of_the_kit_s_models_keeps_a_large_sigma():
    wide = Fisheye(520.0, 520.0, 639.5, 359.5, 1280, 720, (0.02, -0.01))
    lens = lens_prior(wide, 0, 1.0)
    sigma = np.sqrt(np.linalg.inv(lens.information)[0, 0])
    assert np.isfinite(lens.mean).all() and (lens.off_px < 1.0 or sigma > 0.01)


def test_the_prior_is_on_the_calibrated_eyes_alone():
    config = CalibrationConfig(cameras=(PRIMARY,))
    belief, lines = optics_belief(config, SIZES)
    assert lines == [] and belief is not None
    known = np.flatnonzero(np.diag(belief.information))
    assert set(known) == {*layout.OPTICS[0], layout.FAMILY[0]}
    joint = product([layout.prior((None, None)), belief])
    primary, _ = layout.cameras(joint.mean, SIZES)
    assert primary.fx == pytest.approx(812.0, rel=2e-3)
    sigma = np.sqrt(np.diag(covariance(joint)))[layout.LOG_FOCAL]
    assert sigma[0] < 0.01 and sigma[1] == pytest.approx(layout.LOG_FOCAL_SIGMA, rel=0.01)


def test_another_video_mode_is_scaled_or_left_out_with_a_sentence():
    config = CalibrationConfig(cameras=(PRIMARY, WIDE))
    belief, (line,) = optics_belief(config, np.array([[640, 360], [640, 480]]))
    primary, _ = layout.cameras(belief.mean, np.array([[640, 360], [640, 480]]))
    assert primary.fx == pytest.approx(406.0, rel=1e-3) and "primary camera was" in line
    belief, (line,) = optics_belief(config, np.array([[1280, 720], [640, 360]]))
    assert "assistant" in line and "cropped" in line
    assert not belief.information[layout.OPTICS[1]].any()
    belief, lines = optics_belief(config, np.array([[1280, 960], [640, 360]]))
    assert belief is None and len(lines) == 2


def test_the_rig_is_brought_to_one_spacing():
    belief = rig_belief(CalibrationConfig(rig=(0.01, -0.02, 0.0, 2.0, 0.0, 0.0)))
    assert belief.mean[layout.RIG].tolist() == [0.01, -0.02, 0.0, 1.0, 0.0, 0.0]
    assert rig_belief(CalibrationConfig()) is None
    for wrong in ((1.0,), (0.0,) * 6):
        with pytest.raises(ConfigError, match=r"calibration\.rig"):
            rig_belief(CalibrationConfig(rig=wrong))


def test_the_differences_of_models_are_said():
    many = CalibratedCameraConfig("perspective", 812.0, 830.0, 655.0, 350.0, 1280, 720, (), 0.7)
    exact, fitted = described(CalibrationConfig(cameras=(PRIMARY, many)))
    assert "primary: focal 812.0 px, sigma 0." in exact and "off" not in exact
    assert "fitted, at most 0.7 px off" in fitted and "terms of the kit are at most" in fitted


def test_a_configured_camera_survives_the_recorded_configuration():
    config = merge(Config(), {"calibration": {"file": "camchain.yaml"}})
    assert config.calibration.file == ("camchain.yaml",)
    calibration = {"cameras": [{"model": "fisheye", "fx": 1, "fy": 1, "cx": 0, "cy": 0}]}
    with pytest.raises(ConfigError, match=r"calibration\.cameras\.width: missing"):
        merge(config, {"calibration": calibration})
    calibration["cameras"][0] |= {"width": 1, "height": 1}
    whole = merge(config, {"calibration": calibration})
    assert merge(Config(), whole.to_dict()) == whole


def test_an_impossible_configured_camera_is_refused():
    for change in ({"fx": -1.0}, {"model": "fisheye", "fx": 100.0, "fy": 100.0}):
        entry = CalibratedCameraConfig(**{**PRIMARY_FIELDS, **change})
        with pytest.raises(ConfigError, match=r"calibration\.cameras"):
            camera_of(entry)


PRIMARY_FIELDS = {
    "model": "perspective", "fx": 812.0, "fy": 812.0, "cx": 655.0, "cy": 350.0, "width": 1280,
    "height": 720,
}  # fmt: skip
