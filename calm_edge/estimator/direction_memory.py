"""Direction of travel in the primary's axes: how the camera is mounted, learned over the drive."""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float

# A window counts if its path is longer than this number of spacings: at standstill noise has any
# direction.
MIN_PATH = 5.0
# Windows remembered: a camera that is turned in mid-drive is followed.
MAX_WINDOWS = 9


class DirectionMemory:
    """Median of the directions of travel of the newest windows."""

    def __init__(self) -> None:
        self._found: list[Float] = []

    @property
    def direction(self) -> Float | None:
        """Unit vector (3,), camera axes, or None before a window has moved."""
        if not self._found:
            return None
        median = np.median(self._found, axis=0)
        length = float(np.linalg.norm(median))
        return median / length if length > 0 else None

    def add(self, T_s_p: Float, spacing: float) -> None:
        """Note the path T_s_p (N, 4, 4) of a window's primary. spacing: in its unit."""
        step = se3.inverse(T_s_p[:-1]) @ T_s_p[1:]
        length = np.linalg.norm(step[:, :3, 3], axis=1)
        if length.sum() < MIN_PATH * spacing:
            return
        # on an arc, the car points along the chord half way through the turn
        half = se3.so3_exp(-se3.so3_log(step[:, :3, :3]) / 2)
        chord = (half @ step[:, :3, 3, None])[..., 0]
        known = self.direction
        ahead = np.array([0.0, 0.0, 1.0]) if known is None else known
        # a car that reverses moves along the same axis
        mean = (chord * np.where(chord @ ahead < 0, -1.0, 1.0)[:, None]).sum(0)
        self._found = [*self._found, mean / np.linalg.norm(mean)][-MAX_WINDOWS:]
