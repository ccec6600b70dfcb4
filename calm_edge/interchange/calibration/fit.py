"""Best fit of our camera models to a lens of any other model."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.interchange.calibration.calibration import CalibrationError
from calm_edge.interchange.calibration.lens import Lens
from calm_edge.types import Float

# Directions at which a lens is sampled: azimuths, and angles off the axis up to beyond 90 degrees.
_AZIMUTHS = np.linspace(0, 2 * np.pi, 48, endpoint=False)
_ANGLES = np.radians(np.linspace(0.1, 100.0, 250))
# Cells by which it is judged how much of the picture the samples cover.
_CELLS = 16, 12
MIN_COVERED = 0.95
# Distortion terms of the models that are tried: radial and tangential ones, rational, fisheye.
_TRIED: tuple[tuple[type[Fisheye] | type[Perspective], int], ...] = (
    (Fisheye, 4),
    (Perspective, 5),
    (Perspective, 8),
)


def fitted(where: str, lens: Lens) -> tuple[Camera, float]:
    """Fit all models; return the best camera and its largest difference over the picture [px].

    where: file and camera, for messages. Raises CalibrationError.
    """
    rays, uv = _sampled(where, lens)
    found: list[tuple[float, Camera]] = []
    refused = "no model of ours fits"
    for model, terms in _TRIED:
        try:
            camera = _fit(model, terms, lens, rays, uv)
        except ValueError as error:  # a fisheye lens that is too wide
            refused = str(error)
            continue
        inside = rays[:, 2] > np.cos(camera.max_angle)
        if isinstance(camera, Perspective) and not inside.all():
            continue
        found.append((float(np.abs(camera.project(rays) - uv).max()), camera))
    if not found:
        raise CalibrationError(f"{where}: {refused}")
    off_px, best = min(found, key=lambda each: each[0])
    return best, off_px


def _sampled(where: str, lens: Lens) -> tuple[Float, Float]:
    """Directions (N, 3) that the picture shows, and their pixels (N, 2)."""
    angle, azimuth = np.meshgrid(_ANGLES, _AZIMUTHS)
    across = np.sin(angle)
    rays = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(angle)], -1)
    with np.errstate(all="ignore"):
        uv = lens.project(rays)
        radius = np.linalg.norm(uv - [lens.cx, lens.cy], axis=-1)
        grows = np.diff(radius, axis=1, prepend=0.0) > 0
        inside = (uv >= -0.5).all(-1) & (uv <= [lens.width - 0.5, lens.height - 0.5]).all(-1)
    # beyond the first angle at which the image folds or leaves the picture nothing is used
    seen = np.logical_and.accumulate(grows & inside, axis=1)
    rays, uv = rays[seen], uv[seen]
    columns, rows = _CELLS
    cells = np.floor((uv + 0.5) / [lens.width, lens.height] * [columns, rows]).astype(int)
    covered = len(np.unique(cells, axis=0)) / (columns * rows)
    if covered < MIN_COVERED:
        raise CalibrationError(
            f"{where}: the lens model covers only {100 * covered:.0f} % of the picture "
            "within 100 degrees of the axis"
        )
    return rays, uv


def _fit(
    model: type[Fisheye] | type[Perspective], terms: int, lens: Lens, rays: Float, uv: Float
) -> Camera:
    """Least-squares fit of a model to samples; raises ValueError for a lens that is too wide."""

    def camera(x: Float, width: int = 1, height: int = 1) -> Camera:
        # a picture of one pixel, until the fit is done: no lens is too wide for it
        fx, fy, cx, cy, *k = x.tolist()
        return model(fx, fy, cx, cy, width, height, tuple(k))

    if model is Perspective:
        ahead = rays[:, 2] > np.cos(np.radians(80.0))
        rays, uv = rays[ahead], uv[ahead]
    start = np.array([lens.fx, lens.fy, lens.cx, lens.cy, *[0.0] * terms])
    near = np.argsort(-rays[:, 2])[: len(rays) // 10]
    q = rays[near, :2] / rays[near, 2:]
    start[:2] = ((uv[near] - [lens.cx, lens.cy]) * q).sum(0) / (q * q).sum(0)

    def residuals(x: Float) -> Float:
        return np.asarray((camera(x).project(rays) - uv).ravel())

    def jacobian(x: Float) -> Float:
        return camera(x).parameter_jacobian(rays).reshape(-1, len(start))

    solved = least_squares(residuals, start, jac=jacobian, x_scale="jac", max_nfev=100)
    return camera(solved.x, lens.width, lens.height)
