"""Lenses that a calibration or a belief on the kit knows well enough to undistort pictures.

A focal length need not be known for that, only how the picture bends: a backbone that models
pinhole cameras estimates the focal length itself.
"""

from __future__ import annotations

import numpy as np

from calm_edge.config import CalibrationConfig
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.fisheye import FieldTooWide
from calm_edge.kit import layout
from calm_edge.kit.belief import covariance, product
from calm_edge.kit.calibration import camera_of, matched
from calm_edge.types import KitBelief

# Largest sigma of pixels, as share of the picture's width: 1.3 px of 640.
BEND_KNOWN = 0.002
# Pixels at which it is computed; rays farther off the axis are outside of undistorted pictures.
_GRID = 25, 15
_LEAST_Z = float(np.cos(np.radians(50.0)))


def calibrated_lens(config: CalibrationConfig, eye: int, width: int, height: int) -> Camera | None:
    """The calibrated camera of an eye, for pictures of this size; None if there is none for it."""
    if eye >= len(config.cameras):
        return None
    camera, _ = matched(camera_of(config.cameras[eye]), width, height)
    return camera


def learned_lens(belief: KitBelief | None, eye: int, width: int, height: int) -> Camera | None:
    """The camera of a belief on the kit for an eye; None if `bend_sigma` is above BEND_KNOWN."""
    if belief is None or not layout.of_lens(belief)[eye]:
        return None
    families = layout.families(belief.mean)
    sizes = np.array([[width, height]] * 2)
    whole = product([layout.prior((None, None), sizes, families=families), belief])
    assert whole is not None
    try:
        camera = layout.camera(whole.mean, eye, width, height)
    except FieldTooWide:
        return None
    known = bend_sigma(whole, eye, width, height) <= BEND_KNOWN * width
    return camera if known else None


def bend_sigma(belief: KitBelief, eye: int, width: int, height: int) -> float:
    """Sigma [px], rms over the picture, of where the lens of an eye images a ray.

    What another focal length or centre of the undistorted picture explains does not count.
    """
    camera = layout.camera(belief.mean, eye, width, height)
    rays = camera.rays(camera.pixel_grid(*_GRID))
    rays = rays[rays[:, 2] > _LEAST_Z]
    terms = layout.OPTICS[eye]
    C = covariance(belief)[np.ix_(terms, terms)]
    # by fx, fy, cx, cy and the terms of the lens -> by the kit's terms, with widths as unit
    P = camera.parameter_jacobian(rays)
    by_log_focal = P[..., :2] @ [[camera.fx], [camera.fy]]
    moved = np.concatenate([by_log_focal, width * P[..., 2:4], P[..., 4:]], -1)
    q = rays[:, :2] / rays[:, 2:]
    one, none = np.ones(len(q)), np.zeros(len(q))
    pinhole = np.stack([[q[:, 0], none], [none, q[:, 1]], [one, none], [none, one]], -1)
    at_one = np.concatenate([q, one[:, None]], 1)
    A = camera.project_jacobian(at_one)[..., :2] @ pinhole.transpose(1, 0, 2)
    A, b = A.reshape(-1, A.shape[-1]), moved.reshape(-1, len(terms))
    bend = b - A @ np.linalg.lstsq(A, b, rcond=None)[0]
    return float(np.sqrt(np.einsum("ni,ij,nj->", bend, C, bend) / len(rays)))
