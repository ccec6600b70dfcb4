"""Where a map lies on the Earth, by the GPS fixes of its drive."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calm_edge.geometry import local_enu
from calm_edge.interchange import InterchangeError
from calm_edge.types import Float

# as `map` writes it
GPS_SUMMARY = "gps.json"
_REMEDY = "run calm-edge map again"


@dataclass(frozen=True, slots=True)
class Georeference:
    """Similarity of the world to east, north, up: p_enu = scale R_enu_w p_w + t [m].

    origin: latitude, longitude [deg], height over the ellipsoid [m]. tilt_sigma_deg: of the
    vertical, inf if not known. residual_m: rms distance of the path from the fixes.
    """

    origin: Float
    R_enu_w: Float
    t: Float
    scale: float
    tilt_sigma_deg: float
    residual_m: float

    def enu(self, p_w: Float) -> Float:
        """Convert points (N, 3) of the world to east, north, up."""
        return np.asarray(self.scale * p_w @ self.R_enu_w.T + self.t)

    def geodetic(self, p_w: Float) -> Float:
        """Convert points (N, 3) to latitude, longitude [deg], height over the ellipsoid [m]."""
        return local_enu.geodetic(self.enu(p_w), self.origin)

    def described(self) -> tuple[str, ...]:
        """Lines for the user."""
        latitude, longitude, height = self.origin.tolist()
        return (
            f"georeferenced by GPS at {latitude:.7f}, {longitude:.7f}, {height:.1f} m; "
            f"{self.residual_m:.2f} m from the fixes (rms)",
            "WGS 84, heights over the ellipsoid, not over the sea",
        )


def read_georeference(folder: Path) -> Georeference | None:
    """Read that of a map folder, None if it has none; raises InterchangeError."""
    path = folder / GPS_SUMMARY
    if not path.is_file():
        return None
    try:
        content = json.loads(path.read_text())
        T = np.array(content["T_enu_w"], np.float64).reshape(4, 4)
        origin = np.array(content["origin_deg_deg_m"], np.float64).reshape(3)
        tilt = content.get("tilt_sigma_deg")
        found = Georeference(
            origin,
            T[:3, :3],
            T[:3, 3],
            float(content["scale"]),
            np.inf if tilt is None else float(tilt),
            float(content["residual_rms_m"]),
        )
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InterchangeError(f"{path}: not readable ({error!r}); {_REMEDY}") from None
    if not np.isfinite([*T.ravel(), *origin, found.scale]).all() or found.scale <= 0:
        raise InterchangeError(f"{path}: holds numbers that are not finite; {_REMEDY}")
    return found
