"""Errors of single windows, each by itself, over the sigmas claimed for them.

The length of a window's path tests its scale, given the true spacing. The motion over SPAN_S within
a window tests its poses, whatever connects it to others.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.normalised import Normalised, normalised
from calm_edge.evaluation.trajectory import associate
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.types import Float, LocalizerUpdate, Metre, Prediction, Submap

SPAN_S = 1.0
# A shorter true path, in spacings, has no meaningful relative error: the car stood.
LEAST_SPACINGS = 2.0


@dataclass(frozen=True, slots=True)
class Motions:
    """Errors of B motions: error, sigma (B, 6) of (translation [m], rotation [rad]).

    In the axes of the later pose. sigma is NaN where none is claimed.
    """

    error: Float
    sigma: Float


@dataclass(frozen=True, slots=True)
class DriveErrors:
    """Errors of one drive.

    first, last: (W, 2) error of the log scale of each window and its sigma, as first solved and in
    the end. motions: as first solved. whole: error of the log of all windows' lengths together, and
    the sigma of the metre; NaN without a window.
    """

    first: Float
    last: Float
    motions: Motions
    whole: tuple[float, float]


def drive_errors(
    updates: Sequence[LocalizerUpdate],
    last: Sequence[Submap],
    metre: Metre,
    truth: Truth,
    spacing_m: float,
) -> DriveErrors:
    """Compare with the truth: updates as first solved, sub-maps and metre of the end."""
    least = LEAST_SPACINGS * spacing_m
    first = [update.submap for update in updates]
    paths = np.array([lengths(submap, truth) for submap in last]).reshape(-1, 2).sum(0)
    whole = np.nan if paths[1] < least else float(np.log(paths[0] / paths[1]))
    parts = [motions(u.submap, u.prediction, truth) for u in updates]
    joined = Motions(
        np.concatenate([np.zeros((0, 6)), *(part.error for part in parts)]),
        np.concatenate([np.zeros((0, 6)), *(part.sigma for part in parts)]),
    )
    return DriveErrors(
        _scales(first, truth, least), _scales(last, truth, least), joined, (whole, metre.log_sigma)
    )


def lengths(submap: Submap, truth: Truth) -> tuple[float, float]:
    """Estimated and true length [m] of the primary's path, over the keyframes that have a truth."""
    view, row = associate(submap.t_ns[: submap.n_primary], truth.t_ns)
    paths = submap.T_s_c[view, :3, 3], truth.T_w_c[row, :3, 3]
    estimate, true = (np.linalg.norm(np.diff(p, axis=0), axis=-1).sum() for p in paths)
    return float(estimate), float(true)


def motions(submap: Submap, prediction: Prediction, truth: Truth) -> Motions:
    """Motions of the primary over SPAN_S in one window, end to end."""
    view, row = associate(submap.t_ns[: submap.n_primary], truth.t_ns)
    t_s = submap.t_ns[view] * 1e-9
    errors, sigmas, i = [], [], 0
    while len(t_s) and (j := int(np.searchsorted(t_s, t_s[i] + SPAN_S - 1e-6))) < len(t_s):
        a, b = view[i], view[j]
        moved = se3.inverse(submap.T_s_c[a]) @ submap.T_s_c[b]
        true = se3.inverse(truth.T_w_c[row[i]]) @ truth.T_w_c[row[j]]
        errors.append(se3.log(se3.inverse(true) @ moved))
        sigmas.append(_sigma(prediction, int(a), int(b), submap.scale))
        i = j
    return Motions(np.array(errors).reshape(-1, 6), np.array(sigmas).reshape(-1, 6))


def table(drives: Iterable[DriveErrors]) -> tuple[Normalised, ...]:
    """Errors over sigmas of all windows, motions and drives."""
    drives = list(drives)
    first, last = (
        np.concatenate([np.zeros((0, 2)), *(getattr(drive, name) for drive in drives)])
        for name in ("first", "last")
    )
    error = np.concatenate([np.zeros((0, 6)), *(drive.motions.error for drive in drives)])
    sigma = np.concatenate([np.zeros((0, 6)), *(drive.motions.sigma for drive in drives)])
    whole = np.array([drive.whole for drive in drives]).reshape(-1, 2)
    position, rotation = slice(0, 3), slice(3, 6)
    return (
        normalised("log scale, as first solved", *first.T),
        normalised("log scale, in the end", *last.T),
        normalised("log length of a drive", *whole.T),
        normalised(
            "position after 1 s", error[:, position].ravel(), sigma[:, position].ravel(), "m",
            _median(sigma[:, position]),
        ),
        normalised(
            "rotation after 1 s", error[:, rotation].ravel(), sigma[:, rotation].ravel(), "deg",
            _median(np.degrees(sigma[:, rotation])),
        ),
    )  # fmt: skip


def _scales(submaps: Iterable[Submap], truth: Truth, least_m: float) -> Float:
    """Error and sigma (W, 2) of the log scale of the windows that moved."""
    out = []
    for submap in submaps:
        estimate, true = lengths(submap, truth)
        if true >= least_m:
            out.append((np.log(max(estimate, 1e-9) / true), submap.scale_log_sigma))
    return np.array(out).reshape(-1, 2)


def _sigma(prediction: Prediction, a: int, b: int, scale: float) -> Float:
    """Claimed sigmas (6,) of the motion from view a to view b; scale: metres per raw unit."""
    if prediction.covariance is None:
        return np.full(6, np.nan)
    moved = se3.inverse(prediction.T_s_c[a]) @ prediction.T_s_c[b]
    rows = np.r_[6 * a : 6 * a + 6, 6 * b : 6 * b + 6]
    J = np.hstack([-se3.adjoint(se3.inverse(moved)), np.eye(6)])
    variance = np.diag(J @ prediction.covariance[np.ix_(rows, rows)] @ J.T)
    return np.asarray(np.sqrt(variance) * np.repeat([scale, 1.0], 3))


def _median(sigma: Float) -> float | None:
    return float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else None
