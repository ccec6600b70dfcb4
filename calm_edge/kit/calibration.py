"""A known calibration as a prior on the kit: Gaussians of a stated sigma, in the kit's own terms.

A lens of more terms than the kit has is fitted by the kit's; the largest difference over the
picture adds to the sigma.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from calm_edge.config import CalibratedCameraConfig, CalibrationConfig, ConfigError
from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.kit import layout
from calm_edge.kit.lens import Family
from calm_edge.types import Float, Int, KitBelief

EYES = "primary", "assistant"
# Sizes are of one picture, scaled, if their aspect ratios differ by at most this share.
SAME_ASPECT = 0.005
# Pixels at which lenses are compared: columns and rows from corner to corner.
_GRID = 25, 15
# Rays farther off the axis are not compared: no perspective camera has them in its picture.
_LEAST_Z = np.cos(np.radians(85.0))


# A difference between two lens models that no match can show.
NEGLIGIBLE_PX = 0.05


@dataclass(frozen=True, slots=True)
class LensPrior:
    """Prior on the optics of an eye: mean and information of its terms in `layout.OPTICS`.

    off_px: largest difference of the kit's lens model to the calibrated one over the picture.
    """

    mean: Float
    information: Float
    off_px: float


def camera_of(entry: CalibratedCameraConfig) -> Camera:
    """The camera of a configuration; raises ConfigError."""
    optics = entry.fx, entry.fy, entry.cx, entry.cy, entry.width, entry.height
    try:
        if min(entry.fx, entry.fy, entry.width, entry.height) <= 0:
            raise ValueError("focal lengths and sizes must be positive")
        if entry.model == "fisheye":
            return Fisheye(*optics, entry.distortion)
        return Perspective(*optics, entry.distortion)
    except ValueError as error:
        raise ConfigError(f"calibration.cameras: {error}") from None


def matched(camera: Camera, width: int, height: int) -> tuple[Camera | None, str]:
    """Convert a camera to pictures of another size; return a sentence if its own differs.

    None for another aspect ratio: the picture is cropped, and where is unknown.
    """
    if (camera.width, camera.height) == (width, height):
        return camera, ""
    sizes = (
        f"calibrated for pictures of {camera.width} x {camera.height} px, "
        f"these have {width} x {height} px"
    )
    sx, sy = width / camera.width, height / camera.height
    if abs(sx / sy - 1) > SAME_ASPECT:
        return None, f"{sizes}: cropped in an unknown way; calibrate in this video mode"
    scaled = replace(camera.scaled(sx, sy), width=width, height=height)
    return scaled, f"{sizes}: scaled, which is wrong if this video mode shows a part of the sensor"


def lens_prior(camera: Camera, eye: int, sigma_px: float) -> LensPrior:
    """Prior on the optics of an eye from its camera.

    sigma_px: rms over the picture, of the camera. The covariance is that of a fit to pixels: terms
    that replace each other are known together only.
    """
    rays, uv = sampled(camera)
    theta, terms = layout.prior((None, None)).mean.copy(), layout.OPTICS[eye]
    theta[layout.FAMILY[eye]] = family_of(camera)
    theta[layout.LOG_FOCAL[eye]] = np.log(np.sqrt(camera.fx * camera.fy) / camera.width)

    def off(x: Float) -> Float:
        theta[terms] = x
        fitted = layout.camera(theta, eye, *_size(camera))
        return np.asarray((fitted.project(rays) - uv).ravel())

    solved = least_squares(off, theta[terms].copy(), x_scale="jac", max_nfev=100)
    off_px = float(np.abs(solved.fun).max())
    # mean over pixels, of both coordinates: so that the rms over the picture is the sigma
    J = np.asarray(solved.jac)
    H = J.T @ J / len(rays)
    information = len(terms) * H / (sigma_px**2 + off_px**2)
    return LensPrior(np.asarray(solved.x), np.asarray(information), off_px)


def family_of(camera: Camera) -> Family:
    """The family of the kit's lenses that a camera is of."""
    return Family.FISHEYE if isinstance(camera, Fisheye) else Family.PERSPECTIVE


def sampled(camera: Camera) -> tuple[Float, Float]:
    """Rays (N, 3) and pixels (N, 2) that cover the picture from corner to corner."""
    uv = camera.pixel_grid(*_GRID)
    rays = camera.rays(uv)
    seen = rays[:, 2] > _LEAST_Z
    return rays[seen], uv[seen]


def described(config: CalibrationConfig) -> Iterator[str]:
    """Lines for the user on the cameras of a configuration, each at its own size."""
    for eye, entry in enumerate(config.cameras):
        lens = lens_prior(camera_of(entry), eye, config.sigma_px)
        log_focal = np.linalg.inv(lens.information)[0, 0] ** 0.5
        focal = f"focal {entry.fx:.1f} px, sigma {100 * log_focal:.2f} %"
        text = f"calibration of the {EYES[eye]}: {focal}"
        if entry.fit_px:
            text += f"; its lens model is fitted, at most {entry.fit_px:.2g} px off"
        if lens.off_px > NEGLIGIBLE_PX:
            text += f"; the lens terms of the kit are at most {lens.off_px:.2g} px off"
        yield text


def optics_belief(config: CalibrationConfig, sizes: Int) -> tuple[KitBelief | None, list[str]]:
    """Prior on the optics for pictures of sizes (2, 2) [px]; None if no camera can be used.

    Returns sentences on cameras that were calibrated for other sizes.
    """
    mean, information = _nothing()
    lines: list[str] = []
    for eye, entry in enumerate(config.cameras):
        camera, text = matched(camera_of(entry), *sizes[eye].tolist())
        if text:
            lines.append(f"the {EYES[eye]} camera was {text}")
        if camera is None:
            continue
        fit_px = entry.fit_px * camera.width / entry.width
        lens = lens_prior(camera, eye, float(np.hypot(config.sigma_px, fit_px)))
        terms = layout.OPTICS[eye]
        mean[terms], information[np.ix_(terms, terms)] = lens.mean, lens.information
        mean[layout.FAMILY[eye]] = family_of(camera)
        information = layout.with_known_families(information, (eye == 0, eye == 1))
    return (KitBelief(mean, information) if information.any() else None), lines


def rig_belief(config: CalibrationConfig) -> KitBelief | None:
    """Prior on the rig, with the drift of a mount between two drives as sigma; None without one."""
    if not config.rig:
        return None
    vector = np.array(config.rig)
    if vector.shape != (6,) or not np.linalg.norm(vector[3:]) > 0:
        raise ConfigError("calibration.rig: expected a rotation vector and a centre, 6 numbers")
    mean, information = _nothing()
    mean[layout.RIG] = vector
    mean[layout.RIG_CENTRE] /= np.linalg.norm(vector[3:])
    rig = np.arange(layout.SIZE)[layout.RIG]
    information[rig, rig] = layout.drift_sigma()[rig] ** -2.0
    return KitBelief(mean, information)


def _nothing() -> tuple[Float, Float]:
    """Mean of the prior, and no information."""
    return layout.prior((None, None)).mean.copy(), np.zeros((layout.SIZE, layout.SIZE))


def _size(camera: Camera) -> tuple[int, int]:
    return camera.width, camera.height
