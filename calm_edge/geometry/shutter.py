"""Rolling shutter: rows are exposed one after the other while the camera moves.

Stamps and poses are those of the middle row.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


def at_middle_row(
    camera: Camera, p_c: Float, uv: Float | Float32, twist_c: Float, readout_s: float
) -> Float:
    """Move pixels (M, 2) to where they would be if all rows were exposed with the middle one.

    p_c: (M, 3) points, camera axes. twist_c: (6,) velocity and turn rate of the camera in its own
    axes, in the unit of the points per second and rad/s. readout_s: from the exposure of the first
    row to that of the last. To first order in the readout time; pixels of points behind the camera
    stay.
    """
    after_s = readout_s * (uv[:, 1] / (camera.height - 1) - 0.5)
    velocity = -twist_c[:3] - np.cross(twist_c[3:], p_c)
    shift = np.einsum("nij,nj->ni", camera.project_jacobian(p_c), velocity) * after_s[:, None]
    return np.asarray(uv - np.where(p_c[:, 2:] > 0, shift, 0.0), np.float64)
