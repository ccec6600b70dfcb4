"""Errors of the motion along a sub-map, from the covariance of its window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.types import METRIC_LOG_SIGMA, Float, LocalizerUpdate

_LEAST_LENGTH = 1e-9


@dataclass(frozen=True, slots=True)
class SubmapErrors:
    """Sigmas of a sub-map that the motion of poses tracked in it inherits.

    scale_log_sigma: of the log of its lengths. focal_log_sigma: of the primary's log focal length.
    by_length: (6, 6) covariance of (translation, rotation) that one world unit of path adds, in
    axes of the camera at its end, given the scale; NaN if the backbone estimates none.
    """

    scale_log_sigma: float
    focal_log_sigma: float
    by_length: Float

    @property
    def metric(self) -> bool:
        """Whether lengths are known well enough to be reported."""
        return self.scale_log_sigma <= METRIC_LOG_SIGMA

    def of_turn(self, turn: Float) -> Float:
        """Error (6,) of a turn (3,) [rad], camera axes, for one sigma of the focal length.

        A focal that is too long makes turns about x and y too small.
        """
        return np.asarray([0.0, 0.0, 0.0, *(-self.focal_log_sigma * turn[:2]), 0.0])

    @classmethod
    def of_update(cls, update: LocalizerUpdate) -> SubmapErrors:
        """Those of a new sub-map: its window's errors, spread evenly over the window's path."""
        submap, covariance = update.submap, update.prediction.covariance
        by_length = np.full((6, 6), np.nan)
        if covariance is not None:
            T_s_p = submap.T_s_c_raw[: submap.n_primary]
            motion, length = motion_given_length(T_s_p, covariance.astype(np.float64))
            units = np.repeat([submap.scale, 1.0], 3)
            by_length = units[:, None] * motion * units / max(submap.scale * length, _LEAST_LENGTH)
        return cls(update.scale_log_sigma, float(submap.focal_log_sigma[0]), by_length)


def motion_given_length(T_s_c: Float, covariance: Float) -> tuple[Float, float]:
    """Covariance (6, 6) of the last of N poses relative to the first, given the path's length.

    T_s_c: (N, 4, 4). covariance: (6 N, 6 N), (translation, rotation) of each pose in its own axes,
    relative to the first. Also returns the length of the path.
    """
    step = np.diff(T_s_c[:, :3, 3], axis=0)
    length = np.linalg.norm(step, axis=1)
    along = step / np.maximum(length, _LEAST_LENGTH)[:, None]
    by_centre = -np.diff(along, axis=0, prepend=0.0, append=0.0)
    by_pose = np.zeros((len(T_s_c), 6))
    by_pose[:, :3] = (np.swapaxes(T_s_c[:, :3, :3], -1, -2) @ by_centre[..., None])[..., 0]
    with_length = covariance @ by_pose.ravel()
    variance = float(by_pose.ravel() @ with_length)
    motion = covariance[-6:, -6:]
    if variance > 0:
        motion = motion - np.outer(with_length[-6:], with_length[-6:]) / variance
    return motion, float(length.sum())
