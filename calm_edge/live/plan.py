"""The path and the newest points from above, while they are being estimated."""

from __future__ import annotations

from typing import Any

import numpy as np

from calm_edge.config import PoseOutputConfig
from calm_edge.geometry import body_frame, se3
from calm_edge.geometry.polyline import path_length
from calm_edge.recording.display import landmarks
from calm_edge.types import Float, LocalizerUpdate

PATH_POINTS, CLOUD_POINTS = 600, 500


class Plan:
    """Top view of one drive in the axes of the car at its start: x to the right, y ahead.

    The primary camera's path. Lengths are in world units.
    """

    def __init__(self, mounting: PoseOutputConfig) -> None:
        R = body_frame.mounting(mounting.mounting_rpy_deg)[:3, :3]
        # of a body that looks forward, right and down
        self._axes = R[[1, 0]]
        self._path: dict[int, Float] = {}
        self._newest: LocalizerUpdate | None = None

    def update(self, update: LocalizerUpdate) -> None:
        """Take new and moved keyframes, and the newest sub-map for its points."""
        moved = update.trajectory
        at = moved.T_w_c[:, :3, 3]
        known = zip(moved.keyframe_ids.tolist(), at, strict=True)
        self._path.update((i, p) for i, p in known if np.isfinite(p).all())
        if update.prediction.landmarks is not None:
            self._newest = update

    @property
    def length(self) -> float:
        """Length of the path through all keyframes so far."""
        if len(self._path) < 2:
            return 0.0
        p = np.stack([self._path[i] for i in sorted(self._path)])
        return path_length(p)

    def content(self) -> dict[str, Any]:
        """Path and points for the page, [x, y] each, thinned; the newest keyframe is included."""
        order = sorted(self._path)
        thin = order[::-1][:: max(1, -(-len(order) // PATH_POINTS))][::-1]
        path = self._flat(np.stack([self._path[i] for i in thin])) if thin else np.zeros((0, 2))
        return {
            "path": path.round(2).tolist(),
            "points": self._points().round(2).tolist(),
            "length": round(self.length, 2),
        }

    def pose(self, T_w_c: Float, velocity_c: Float) -> dict[str, Any]:
        """A pose for the page: place, heading (0 ahead, positive to the right) and speed."""
        ahead = self._axes @ T_w_c[:3, :3] @ self._forward()
        x, y = self._flat(T_w_c[None, :3, 3])[0]
        return {
            "x": round(float(x), 3),
            "y": round(float(y), 3),
            "heading_deg": round(float(np.degrees(np.arctan2(ahead[0], ahead[1]))), 1),
            "speed": round(float(np.linalg.norm(velocity_c)), 2),
        }

    def _points(self) -> Float:
        if self._newest is None:
            return np.zeros((0, 2))
        p_w = landmarks(self._newest)
        return self._flat(p_w[:: max(1, -(-len(p_w) // CLOUD_POINTS))])

    def _flat(self, p_w: Float) -> Float:
        return np.asarray(p_w @ self._axes.T)

    def _forward(self) -> Float:
        """The car's forward axis in the camera."""
        return np.asarray(self._axes[1])


def moved(T_w_c: Float, velocity_c: Float, turn_rate_c: Float, seconds: float) -> Float:
    """The pose (4, 4) some time later at constant velocity; unchanged without a velocity."""
    twist = np.concatenate([velocity_c, turn_rate_c])
    if not np.isfinite(twist).all():
        return T_w_c
    return np.asarray(T_w_c @ se3.exp(twist * seconds))
