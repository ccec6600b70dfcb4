"""Poses of both eyes that assume nothing of the stamps: the assistant is not tied to the primary.

The primary's path and points follow from its own views, and each assistant view is then resected
against these points. So the poses show when the assistant was exposed (estimator/late_stamps).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.backbones.bundle import window
from calm_edge.backbones.bundle.initialise import driven, normalised, resection, triangulated
from calm_edge.backbones.bundle.normal_equations import grouped
from calm_edge.backbones.bundle.problem import Measurements, State, rig_ties
from calm_edge.backbones.bundle.solver import robust_weights, solve
from calm_edge.geometry import se3
from calm_edge.geometry.triangulation import triangulate
from calm_edge.kit import layout
from calm_edge.types import Float, Int, KitBelief

# Points and iterations of the primary's solution, and its tolerance.
POINTS, ITERATIONS, TOLERANCE = 200, 15, 1e-3
# An assistant view needs this many points, and a median error below MAX_MEDIAN_PX.
MIN_POINTS, MAX_MEDIAN_PX = 20, 1.5
# A primary solution with a larger robust cost an observation is not used.
MAX_COST = 2.0
# Iterations that refine the resected views. The scale of the Cauchy kernel is the median error, but
# at least NARROW_PX.
REFINEMENTS, NARROW_PX = 12, 0.7
# Factors on the assistant's focal that are tried on the views with the most points.
ZOOMS, GUESS_VIEWS = (1.0, 1.25, 0.8), 3
# points nearer to infinity or to the camera's plane than this are not used
MIN_W, MIN_DEPTH = 1e-4, 1e-3


def solved_apart(m: Measurements, travel: Float | None, prior: KitBelief) -> Float | None:
    """T_s_c (C, 4, 4) of all views, NaN where an assistant view cannot be placed.

    The unit of length is arbitrary. None if the primary's path fails or no view can be placed.
    travel: (3,) direction of travel of earlier windows, camera axes, or None. prior: on the kit.
    Raises BackboneError, LinAlgError, cv2.error.
    """
    P = int((m.eye == 0).sum())
    own = window.thinned(_of_primary(m), POINTS)
    theta = prior.mean.copy()
    # any rig will do: no view depends on it
    theta[layout.RIG_CENTRE] = [1.0, 0.0, 0.0]
    poses = next(driven(own, theta, travel))
    T = np.stack([poses[view] for view in range(P)])
    solved = solve(
        State(T, triangulated(own, T, theta), theta), own, rig_ties(own), prior,
        max_iterations=ITERATIONS, tolerance=TOLERANCE,
    )  # fmt: skip
    if not solved.cost < MAX_COST * len(own.uv):
        return None
    out = np.full((m.n_views, 4, 4), np.nan)
    out[:P] = solved.state.T_c_s
    out[P:] = _assistants(m, out, solved.state.theta, prior)
    return se3.inverse(out) if np.isfinite(out[P:, 0, 0]).any() else None


def _of_primary(m: Measurements) -> Measurements:
    """The primary's views alone, points renumbered."""
    rows, views = m.eye[m.view] == 0, m.eye == 0
    _, point = np.unique(m.point[rows], return_inverse=True)
    return replace(m.at(rows), point=point, eye=m.eye[views], t=m.t[views])


def _assistants(m: Measurements, T_c_s: Float, theta: Float, prior: KitBelief) -> Float:
    """T_c_s (A, 4, 4) of the assistant's views, from points of the primary's, NaN if unplaced.

    T_c_s: (C, 4, 4) with those of the primary. theta: the kit. Each view is resected, then all are
    refined together with the assistant's focal, whose error would turn and shift them.
    """
    first = int((m.eye == 0).sum())
    rays, rows = normalised(m, theta), m.view < first
    n_points = int(m.point.max()) + 1
    T = np.where(np.isfinite(T_c_s), T_c_s, np.eye(4))
    own = m.at(rows)
    X = triangulate(T, own.view, own.point, rays[rows], n_points, own.edge)
    seen = np.flatnonzero(~rows & np.isfinite(X[m.point, 0]) & (X[m.point, 3] > MIN_W))
    points = X[m.point[seen], :3] / X[m.point[seen], 3:]
    view, rays = m.view[seen] - first, rays[seen]
    f, index = float(np.exp(theta[layout.LOG_FOCAL[1]]) * m.size[1, 0]), layout.LOG_FOCAL[1]
    sigma = float(prior.information[index, index]) ** -0.5
    count = np.bincount(view, minlength=m.n_views - first)
    fullest = np.isin(view, np.argsort(-count)[:GUESS_VIEWS])
    guesses = [
        _placed(points[fullest], rays[fullest] / zoom, view[fullest], f * zoom, len(count))
        for zoom in ZOOMS
    ]
    zoom = ZOOMS[int(np.argmin([error for _, error in guesses]))]
    out, _ = _placed(points, rays / zoom, view, f * zoom, len(count))
    known = np.isfinite(out[view, 0, 0])
    return _refined(out, points[known], rays[known], view[known], f, sigma, float(np.log(zoom)))


def _placed(points: Float, rays: Float, view: Int, f: float, A: int) -> tuple[Float, float]:
    """Poses T_c_s (A, 4, 4) of views by resection, NaN where that fails; median error [px]."""
    out = np.full((A, 4, 4), np.nan)
    for a in range(A):
        mine = view == a
        if mine.sum() >= MIN_POINTS:
            found = resection(points[mine], rays[mine], f, None)
            out[a] = np.nan if found is None else found
    known = np.isfinite(out[view, 0, 0])
    if not known.any():
        return out, np.inf
    residual, _, _ = _errors(out[view[known]], points[known], rays[known], 0.0)
    return out, float(np.median(np.linalg.norm(residual, axis=1))) * f


def _refined(
    T: Float, points: Float, rays: Float, view: Int, f: float, sigma: float, log_zoom: float
) -> Float:
    """Refine poses T_c_s (A, 4, 4) and one log focal by reweighted Gauss-Newton; NaN if poor.

    points: (n, 3). rays: (n, 2) on z = 1 of a focal f [px], whose log has the prior `sigma`. view:
    (n,) index of the pose. log_zoom: log of the focal over f, to start from.
    """
    A = len(T)
    T, by_view = T.copy(), grouped(view)
    error = np.full(len(view), np.inf)
    for _ in range(REFINEMENTS if len(view) else 0):
        residual, J, J_zoom = _errors(T[view], points, rays, log_zoom)
        error = np.linalg.norm(residual, axis=1) * f
        w = robust_weights(error, max(NARROW_PX, float(np.median(error)))) * f**2
        # by pose, of the derivatives by itself, by the zoom, and of the residual
        joined = np.concatenate([J, J_zoom[..., None], residual[..., None]], 2)
        sums = np.zeros((A, 6, 8))
        blocks = np.swapaxes(w[:, None, None] * J, 1, 2) @ joined
        sums[by_view.keys] = np.moveaxis(by_view.sum(np.moveaxis(blocks, 0, -1)), -1, 0)
        H, cross, g = sums[..., :6].copy(), sums[..., 6], sums[..., 7]
        own, pull = sigma**-2.0, log_zoom * sigma**-2.0
        own += float((w * (J_zoom**2).sum(1)).sum())
        pull += float((w * (J_zoom * residual).sum(1)).sum())
        H += 1e-6 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(6) + 1e-9 * np.eye(6)
        by_zoom = np.linalg.solve(H, cross[..., None])[..., 0]
        alone = np.linalg.solve(H, g[..., None])[..., 0]
        zoom = -(pull - (cross * alone).sum()) / (own - (cross * by_zoom).sum())
        step = -alone - by_zoom * zoom
        T = se3.exp(step) @ T
        log_zoom += float(zoom)
    for a in range(A):
        mine = error[view == a]
        if len(mine) < MIN_POINTS or np.median(mine) > MAX_MEDIAN_PX:
            T[a] = np.nan
    return T


def _errors(T: Float, points: Float, rays: Float, log_zoom: float) -> tuple[Float, Float, Float]:
    """Residuals (n, 2) of rays, and derivatives by the pose on the left (n, 2, 6) and log zoom.

    T: (n, 4, 4) of each observation.
    """
    p = (T[:, :3, :3] @ points[..., None])[..., 0] + T[:, :3, 3]
    z = np.maximum(p[:, 2], MIN_DEPTH)
    zoom = np.exp(log_zoom)
    q = zoom * p[:, :2] / z[:, None]
    by_point = np.zeros((len(p), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = zoom / z
    by_point[:, :, 2] = -q / z[:, None]
    J = np.concatenate([by_point, by_point @ -se3.hat(p)], 2)
    return q - rays, J, q
