"""Lenses known from a calibration or a belief, and how well the bend of the picture is known."""

from __future__ import annotations

import numpy as np
import pytest

from calm_edge.config import CalibratedCameraConfig, CalibrationConfig
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.kit.known_lens import BEND_KNOWN, bend_sigma, calibrated_lens, learned_lens
from calm_edge.types import KitBelief

ENTRY = CalibratedCameraConfig("perspective", 500, 500, 319.5, 179.5, 640, 360, (-0.2, 0.05))
SIZE = 640, 360


def belief(**sigmas: float) -> KitBelief:
    """Belief on the primary's lens with these sigmas of focal, centre and lens terms."""
    mean = layout.prior((80.0, 80.0)).mean.copy()
    mean[layout.DISTORTION[0]] = -0.2, 0.05
    information = np.zeros((layout.SIZE, layout.SIZE))
    rows = {
        "focal": layout.LOG_FOCAL[[0]],
        "centre": layout.PRINCIPAL_POINT[0],
        "bend": layout.DISTORTION[0],
    }
    for name, sigma in sigmas.items():
        information[rows[name], rows[name]] = sigma**-2
    return KitBelief(mean, layout.with_known_families(information, (True, False)))


def test_a_calibrated_camera_is_taken_as_it_is():
    config = CalibrationConfig(cameras=(ENTRY,))
    lens = calibrated_lens(config, 0, *SIZE)
    assert (lens.fx, lens.distortion) == (500, (-0.2, 0.05))
    assert calibrated_lens(config, 0, 320, 180).fx == 250
    assert calibrated_lens(config, 0, 640, 480) is None
    assert calibrated_lens(config, 1, *SIZE) is None


def test_a_lens_is_known_once_its_bend_is_whatever_its_focal():
    lens = learned_lens(belief(focal=0.03, centre=0.01, bend=0.004), 0, *SIZE)
    assert lens.distortion == pytest.approx((-0.2, 0.05), abs=2e-3)
    assert learned_lens(belief(focal=0.01, centre=0.01), 0, *SIZE) is None
    assert learned_lens(belief(focal=0.03, bend=0.004), 1, *SIZE) is None
    assert learned_lens(None, 0, *SIZE) is None


def test_the_sigma_is_that_of_pixels_of_random_lenses():
    prior = layout.prior((None, None), np.array([SIZE] * 2))
    known = product([prior, belief(focal=0.02, centre=0.005, bend=0.01)])
    sigma = bend_sigma(known, 0, *SIZE)
    assert BEND_KNOWN * SIZE[0] / 10 < sigma < bend_sigma(prior, 0, *SIZE)
    rng, terms = np.random.default_rng(0), layout.OPTICS[0]
    C = np.linalg.inv(known.information)[np.ix_(terms, terms)]
    camera = layout.camera(known.mean, 0, *SIZE)
    rays = camera.rays(camera.pixel_grid(25, 15))
    q = rays / rays[:, 2:]
    square = []
    for draw in rng.multivariate_normal(np.zeros(len(terms)), C, 100):
        theta = known.mean.copy()
        theta[terms] += draw
        off = (layout.camera(theta, 0, *SIZE).project(rays) - camera.project(rays)).ravel()
        J = camera.project_jacobian(q)[..., :2]
        columns = [J[..., 0] * q[:, :1], J[..., 1] * q[:, 1:2], J[..., 0], J[..., 1]]
        A = np.stack([column.ravel() for column in columns], -1)
        off -= A @ np.linalg.lstsq(A, off, rcond=None)[0]
        square.append((off**2).sum() / len(rays))
    assert sigma == pytest.approx(np.sqrt(np.mean(square)), rel=0.2)
