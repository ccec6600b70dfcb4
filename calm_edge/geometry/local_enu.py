"""Local east-north-up coordinates of WGS 84 positions, by way of earth-centred coordinates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

# WGS 84: semi-major axis [m] and flattening
_A, _F = 6_378_137.0, 1 / 298.257223563
_E2 = _F * (2 - _F)


def earth_centred(lla: Float) -> Float:
    """Convert latitude, longitude [deg] and height over the ellipsoid [m] (..., 3) to ECEF [m]."""
    latitude, longitude = np.radians(lla[..., 0]), np.radians(lla[..., 1])
    normal = _A / np.sqrt(1 - _E2 * np.sin(latitude) ** 2)
    across = (normal + lla[..., 2]) * np.cos(latitude)
    up = (normal * (1 - _E2) + lla[..., 2]) * np.sin(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), up], axis=-1)


def enu(lla: Float, origin: Float) -> Float:
    """Convert positions (N, 3), as in `earth_centred`, to east, north, up [m] of an origin (3,)."""
    return np.asarray((earth_centred(lla) - earth_centred(origin)) @ _axes(origin).T)


def geodetic(p: Float, origin: Float) -> Float:
    """Convert east, north, up (N, 3) [m] of an origin to positions: the inverse of `enu`."""
    x, y, z = (p @ _axes(origin) + earth_centred(origin)).T
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1 - _E2))
    # converges by a factor of 300 each
    for _ in range(4):
        normal = _A / np.sqrt(1 - _E2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(z + _E2 * normal * np.sin(latitude), across)
    normal = _A / np.sqrt(1 - _E2 * np.sin(latitude) ** 2)
    # valid at the poles too
    height = across * np.cos(latitude) + z * np.sin(latitude) - _A**2 / normal
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height], axis=1)


def _axes(origin: Float) -> Float:
    """Rows east, north, up (3, 3) in earth-centred axes."""
    latitude, longitude = np.radians(origin[:2])
    sin_a, cos_a = np.sin(latitude), np.cos(latitude)
    sin_o, cos_o = np.sin(longitude), np.cos(longitude)
    return np.array(
        [
            [-sin_o, cos_o, 0.0],
            [-sin_a * cos_o, -sin_a * sin_o, cos_a],
            [cos_a * cos_o, cos_a * sin_o, sin_a],
        ]
    )
