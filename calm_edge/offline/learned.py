"""The calibration that a drive has learned, with its sigmas in words."""

from __future__ import annotations

import numpy as np

from calm_edge import __version__
from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.through_lens import lens_of
from calm_edge.interchange.calibration.calibration import (
    CalibratedCamera,
    Calibration,
    CalibrationError,
)
from calm_edge.kit import layout
from calm_edge.kit.belief import covariance, product
from calm_edge.kit.estimated import picture_sizes
from calm_edge.kit.observed import (
    MAX_DIRECTION_SIGMA_RAD,
    MAX_LOG_FOCAL_SIGMA,
    MAX_ROTATION_SIGMA_RAD,
)
from calm_edge.recording.reader import Recording
from calm_edge.types import Float, KitBelief, LocalizerUpdate

EYES = "primary", "assistant"


def learned(recording: Recording) -> tuple[Calibration, tuple[str, ...]]:
    """Return the calibration at the end of a drive, and lines that state its sigmas.

    The rig is left out if the drive did not show it. Raises CalibrationError if a focal length is
    not observed: other programs would take its guess for a calibration.
    """
    last = None
    for update in recording.updates():
        last = update
    if last is None:
        raise CalibrationError(f"{recording.path}: no window was solved; nothing is learned")
    head = f"learned by calm-edge {__version__} from {recording.path.name}, not from a target"
    if last.kit is None or len(last.kit.mean) != layout.SIZE:
        calibration, notes = _of_submap(recording, last)
    else:
        config = recording.config
        hfov, readout_s = config.backbone.hfov_of_eye, config.capture.readout_s_of_eye
        sizes = picture_sizes(last.submap)
        families = layout.families(last.kit.mean)
        belief = product([layout.prior(hfov, sizes, readout_s, families), last.kit])
        assert belief is not None
        calibration, notes = _of_kit(recording, belief, sizes, config.scale.spacing_m)
    return calibration, (head, *notes)


def _of_kit(
    recording: Recording, belief: KitBelief, sizes: np.ndarray, spacing_m: float
) -> tuple[Calibration, list[str]]:
    """Calibration and lines of a belief. sizes: (2, 2) width, height [px] of each eye."""
    theta, C = belief.mean, covariance(belief)
    sigma, notes = np.sqrt(np.diag(C)), []
    cameras = layout.cameras(theta, sizes)
    for eye, camera in enumerate(cameras):
        log_focal = float(sigma[layout.LOG_FOCAL[eye]])
        _require_observed(recording, EYES[eye], log_focal)
        centre_px = camera.width * float(sigma[layout.PRINCIPAL_POINT[eye]].max())
        notes.append(
            f"{_optics(EYES[eye], camera, log_focal)}, centre {camera.cx:.1f} {camera.cy:.1f} px "
            f"(sigma {centre_px:.1f})"
        )
        terms = zip(camera.distortion, sigma[layout.DISTORTION[eye]], strict=False)
        text = ", ".join(f"k{n} {k:+.4f} (sigma {s:.4f})" for n, (k, s) in enumerate(terms, 1))
        notes.append(f"{'':12}distortion {text}")
    rotation = _largest_sigma(C, np.eye(layout.SIZE)[:, layout.RIG_ROTATION])
    direction = _largest_sigma(C, _across(theta))
    rig: Float | None = None
    if rotation < MAX_ROTATION_SIGMA_RAD and direction < MAX_DIRECTION_SIGMA_RAD:
        rig = layout.rig(theta)
        rig[:3, 3] *= (spacing_m or 1.0) / np.linalg.norm(rig[:3, 3])
        unit = "metres" if spacing_m else "spacings: their distance was not given"
        turned = np.degrees(se3.so3_log(rig[:3, :3]))
        notes.append(
            f"rig         rotation {turned[0]:+.2f} {turned[1]:+.2f} {turned[2]:+.2f} deg (sigma "
            f"{np.degrees(rotation):.2f}), direction sigma {np.degrees(direction):.2f} deg; {unit}"
        )
    else:
        notes.append("rig         not observed in this drive, left out")
    calibrated = tuple(CalibratedCamera(camera, "learned") for camera in cameras)
    return Calibration(calibrated, rig, metric=rig is not None and bool(spacing_m)), notes


def _of_submap(recording: Recording, last: LocalizerUpdate) -> tuple[Calibration, list[str]]:
    """Calibration and lines of a backbone that estimates focal lengths alone."""
    submap, cameras, notes = last.submap, [], []
    for eye, view in enumerate((0, submap.n_primary)):
        camera, sigma = submap.cameras[view], float(submap.focal_log_sigma[eye])
        _require_observed(recording, EYES[eye], sigma)
        cameras.append(CalibratedCamera(camera.standard, "learned"))
        lens = "lens and centre are" if lens_of(camera) is None else "the lens is known and"
        notes.append(f"{_optics(EYES[eye], camera, sigma)}; {lens} not estimated")
    return Calibration(tuple(cameras)), [*notes, "rig         not estimated, left out"]


def _optics(name: str, camera: Camera, log_sigma: float) -> str:
    return f"{name:12}focal {camera.fx:.1f} px (sigma {100 * log_sigma:.2f} %)"


def _require_observed(recording: Recording, name: str, log_sigma: float) -> None:
    if not log_sigma <= MAX_LOG_FOCAL_SIGMA:
        raise CalibrationError(
            f"{recording.path}: the focal length of the {name} is not observed "
            f"(sigma {100 * log_sigma:.0f} %); record a drive with turns"
        )


def _across(theta: Float) -> Float:
    """Axes (D, 2) of theta along which the direction of the assistant changes."""
    tangent = np.linalg.svd(theta[layout.RIG_CENTRE][None])[2][1:].T
    return np.asarray(np.eye(layout.SIZE)[:, layout.RIG_CENTRE] @ tangent)


def _largest_sigma(C: Float, axes: Float) -> float:
    """Largest sigma along a combination of orthonormal axes (D, k) under a covariance (D, D)."""
    return float(np.sqrt(np.linalg.eigvalsh(axes.T @ C @ axes)[-1]))
