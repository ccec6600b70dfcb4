"""The rig and the spacing, given poses of the primary's views and points in any unit."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle.problem import Measurements
from calm_edge.geometry import se3
from calm_edge.kit import layout
from calm_edge.types import Float, Int

NO_FIT = BackboneError("bundle: the rig does not fit the matches between the cameras")
MIN_RESECTION = 10
RESECTION_PX = 4.0
# the spacing is searched such that NEAR_PERCENT % of the points are nearer than a depth [spacings]
# within this range
DEPTHS_IN_SPACINGS = (1.0, 2000.0)
NEAR_PERCENT = 20
N_SPACINGS = 30
# of the log of the spacing, in the fine search
SPACING_TOLERANCE = 1e-3
# sigma of the rotation of a rig that counts as known, and iterations to estimate its error
RIG_SIGMA_RAD = 0.01
RIG_ITERATIONS = 4
# points with a larger |x / z| or |y / z| are not used for that estimate
MAX_SLOPE = 2.0


def usable(X: Float) -> np.ndarray:
    """Mask of points at a finite, positive distance."""
    return np.asarray(np.isfinite(X[:, 0]) & (X[:, 3] > 1e-4))


def fitted_rig(
    m: Measurements, theta: Float, X: Float, assistant: Int, at: Float, found: list[Float]
) -> tuple[Float, Float]:
    """T_p_a (4, 4), initial unit, and theta with the assistant's focal, both from all its views.

    Resection alone turns an error of that focal into a shift of many spacings along the optical
    axis, so rig and focal are fitted together, with the points fixed. found: T_p_a by resection of
    single views. at: poses T_s_p of the primary at the exposures of the views `assistant`.
    """
    stack = np.stack(found)
    rotation = se3.log(se3.inverse(stack)[:, None] @ stack[None])[..., 3:]
    start = stack[int(np.argmin(np.median(np.linalg.norm(rotation, axis=2), axis=1)))]
    uv, p_p = _seen_across(m, X, assistant, at)
    camera = layout.cameras(theta, m.size)[1]
    centre = np.array([camera.cx, camera.cy])

    def error_px(x: Float) -> Float:
        p_a = se3.transform(se3.exp(x[:6]), se3.transform(se3.inverse(start), p_p))
        # another focal scales the picture about the principal point
        predicted = centre + np.exp(x[6]) * (camera.project(_in_front(p_a)) - centre)
        return np.asarray(np.clip(predicted - uv, -1e3, 1e3).ravel())

    fit = least_squares(error_px, np.zeros(7), loss="cauchy", f_scale=2.0, max_nfev=30)
    theta = theta.copy()
    theta[layout.LOG_FOCAL[1]] += fit.x[6]
    return start @ se3.inverse(se3.exp(fit.x[:6])), theta


def side_by_side(
    m: Measurements, theta: Float, X: Float, assistant: Int, at: Float
) -> tuple[Float, float]:
    """The kit with the assistant straight to the right or left, whichever fits better; the spacing.

    For rigs of unknown position whose rotation is in theta: where nearly all points are far, a fit
    of the whole rig confuses a shift along the optical axis with focal and noise.
    """
    tried = []
    for side in (1.0, -1.0):
        kit = theta.copy()
        kit[layout.RIG_CENTRE] = [side, 0.0, 0.0]
        with suppress(BackboneError):
            tried.append((*spacing_of(m, kit, X, assistant, at), kit))
    if not tried:
        raise NO_FIT
    spacing, _, kit = min(tried, key=lambda found: found[1])
    return kit, spacing


def spacing_of(
    m: Measurements, theta: Float, X: Float, assistant: Int, at: Float
) -> tuple[float, float]:
    """The spacing in the initial unit when the rig is known, and the cost of its fit.

    By a coarse and a fine line search. The bundle adjustment converges only from about the right
    scale. The error of the rig's rotation can exceed the parallax of a road, so it is estimated
    anew for each candidate. at: poses T_s_p of the primary at the exposures of the views
    `assistant`.
    """
    uv, p_p = _seen_across(m, X, assistant, at)
    camera, T_p_a = layout.cameras(theta, m.size)[1], layout.rig(theta)
    rotated = p_p @ T_p_a[:3, :3]
    step = T_p_a[:3, :3].T @ T_p_a[:3, 3]

    def cost(spacing: float) -> float:
        p_a = _in_front(rotated - spacing * step)
        error = camera.project(p_a) - uv
        # a small rotation w on the left moves p_a by w x p_a
        J = camera.project_jacobian(p_a) @ -se3.hat(p_a)
        J[np.abs(p_a[:, :2]).max(1) > MAX_SLOPE * p_a[:, 2]] = 0
        w = np.zeros(3)
        for _ in range(RIG_ITERATIONS):
            size = np.linalg.norm(error + J @ w, axis=1)
            weighted = (J / (RESECTION_PX**2 + size**2)[:, None, None]).reshape(-1, 3)
            H = weighted.T @ J.reshape(-1, 3) + np.eye(3) / RIG_SIGMA_RAD**2
            w = np.linalg.solve(H, -weighted.T @ error.ravel())
        size = np.linalg.norm(error + J @ w, axis=1)
        return float(np.log1p((size / RESECTION_PX) ** 2).sum() + w @ w / RIG_SIGMA_RAD**2)

    coarse = np.percentile(p_p[:, 2], NEAR_PERCENT) / np.geomspace(*DEPTHS_IN_SPACINGS, N_SPACINGS)
    best = int(np.argmin([cost(spacing) for spacing in coarse]))
    if best == N_SPACINGS - 1:
        raise NO_FIT
    bounds = np.log(coarse[best + 1]), np.log(coarse[max(best - 1, 0)])
    fine = minimize_scalar(
        lambda x: cost(float(np.exp(x))), bounds=bounds, method="bounded",
        options={"xatol": SPACING_TOLERANCE},
    )  # fmt: skip
    return float(np.exp(fine.x)), float(fine.fun)


def _seen_across(m: Measurements, X: Float, assistant: Int, at: Float) -> tuple[Float, Float]:
    """Known points that the assistant observed: uv (n, 2) px, and p_p (n, 3) in the axes of the
    primary at the assistant's exposure, initial unit. Raises BackboneError with too few."""
    rows = np.flatnonzero(np.isin(m.view, assistant))
    rows = rows[usable(X[m.point[rows]])]
    if len(rows) < MIN_RESECTION:
        raise BackboneError("bundle: no matches between the cameras; let them see the same scene")
    points = X[m.point[rows], :3] / X[m.point[rows], 3:]
    T_p_s = se3.inverse(at)[np.searchsorted(assistant, m.view[rows])]
    return m.uv[rows], (T_p_s[:, :3, :3] @ points[..., None])[..., 0] + T_p_s[:, :3, 3]


def _in_front(p_c: Float) -> Float:
    """Move points (n, 3) behind the camera to the front of it, so that pixels stay finite."""
    return np.concatenate([p_c[:, :2], np.maximum(p_c[:, 2:], 1e-6)], 1)
