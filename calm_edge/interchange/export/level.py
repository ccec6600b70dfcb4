"""Vertical of a drive from its path and from how the camera is mounted.

The car's vertical in camera axes is the axis about which the car turns, perpendicular to the mean
direction of travel (the mount's pitch and roll). A path with turns lies in a plane. Both assume
that the drive neither climbs nor descends on the whole: pictures do not show the vertical.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float

# total turning [rad] from which the axis of the turns gives the mount's roll
LEAST_TURNING = np.radians(30)
# a path is a plane if its narrow side is this share of the long one, and this many spacings
LEAST_WIDTH, LEAST_SPACINGS = 0.1, 10.0
# rad: the plane is not used if it disagrees more with the mount
MAX_DISAGREEMENT = np.radians(10)
# rad: sigmas of the mean slope of a road, of the roll of a mount, and of a camera held anyhow
SLOPE_SIGMA, ROLL_SIGMA, MOUNT_SIGMA = np.radians(2), np.radians(2), np.radians(5)
# a path that ends this near to its start, as a share of its length, neither climbs nor descends
CLOSED = 0.1
# rad: a direction this near to an axis is along it
ALONG = np.radians(10)
# rad: sigma of a vertical that may be upside down
EITHER_WAY = np.radians(90)


@dataclass(frozen=True, slots=True)
class Level:
    """Rotation R_l_w (3, 3) to axes x ahead at the start, y left, z up.

    method: what gives the vertical; doubt: what it cannot show, or "". sigma_deg: of its tilt.
    """

    R_l_w: Float
    method: str
    doubt: str
    sigma_deg: float

    def described(self) -> str:
        """The level in one line."""
        text = f"levelled by {self.method}, sigma {self.sigma_deg:.1f} deg"
        return f"{text}; {self.doubt}" if self.doubt else text


def level(T_w_c: Float, spacing: float) -> Level:
    """Level of a path T_w_c (K, 4, 4) of the primary camera. spacing: in world units."""
    R, p = T_w_c[:, :3, :3], T_w_c[:, :3, 3]
    steps = np.diff(p, axis=0)
    length = float(np.linalg.norm(steps, axis=1).sum())
    if length < LEAST_SPACINGS * spacing:
        axes = _axes(-R[0, :, 1], T_w_c)
        doubt = "the drive is too short to show the mount"
        return Level(axes, "the camera's picture", doubt, float(np.degrees(MOUNT_SIGMA)))
    up_c, turned = mounted(R, steps)
    weight = np.linalg.norm(steps, axis=1)
    up = _unit(((R[:-1] @ up_c) * weight[:, None]).sum(0))
    method, sigma = "the mount's pitch along the path", 0.0
    if turned:
        method = "the mount's pitch along the path and its roll in turns"
    else:
        sigma = float(ROLL_SIGMA)
    spread, directions = np.linalg.svd(p - p.mean(0), full_matrices=False)[1:]
    spread = spread / np.sqrt(len(p))
    wide = spread[1] > max(LEAST_WIDTH * spread[0], LEAST_SPACINGS * spacing)
    normal = directions[2] * np.sign(directions[2] @ up or 1.0)
    if wide and np.arccos(np.clip(normal @ up, -1, 1)) < MAX_DISAGREEMENT:
        up, method = normal, "the plane through the path"
        sigma = float(np.arctan2(spread[2], spread[1]))
    doubt = ""
    if _along(up_c, np.array([0.0, 0.0, 1.0])):
        doubt = "the camera looks straight up or down: which of the two, pictures do not show"
        sigma = float(EITHER_WAY)
    elif np.linalg.norm(p[-1] - p[0]) > CLOSED * length:
        doubt = "a drive that climbs or descends on the whole cannot be levelled by it"
        sigma = float(np.hypot(sigma, SLOPE_SIGMA))
    return Level(_axes(up, T_w_c), method, doubt, float(np.degrees(sigma)))


def best_level(T_w_c: Float, spacing: float, R_up_w: Float | None, sigma_deg: float) -> Level:
    """Level of a path, by GPS heights where these show the vertical better.

    R_up_w: rotation of the world to axes with z up by GPS, None if not known. sigma_deg: of its
    tilt.
    """
    found = level(T_w_c, spacing)
    if R_up_w is None or sigma_deg >= found.sigma_deg:
        return found
    return Level(_axes(R_up_w[2], T_w_c), "GPS heights", "", sigma_deg)


def mounted(R: Float, steps: Float) -> tuple[Float, bool]:
    """Car's vertical in camera axes (3,), and whether turns gave its roll.

    R: (K, 3, 3) camera->world. steps: (K - 1, 3) motion from each pose to the next. The sign is
    that of the picture's vertical; of a camera that looks straight up or down it is not known.
    """
    travel = _travel(R, steps)
    turns = se3.so3_log(np.swapaxes(R[:-1], 1, 2) @ R[1:])
    turns -= turns @ travel[:, None] * travel
    axis = np.linalg.svd(turns, full_matrices=False)[2][0]
    turned = bool(np.abs(turns @ axis).sum() > LEAST_TURNING)
    if turned:
        up = axis
    else:
        up = np.array([0.0, -1.0, 0.0])
        if _along(travel, up):
            # the picture's vertical is along the road: the camera looks up or down
            up = np.array([0.0, 0.0, 1.0])
    up = up - (up @ travel) * travel
    return _unit(up * (1.0 if up[1] < 0 else -1.0)), turned


def _travel(R: Float, steps: Float) -> Float:
    """Mean direction of travel in camera axes (3,); arguments as of `mounted`."""
    return _unit(np.einsum("kji,kj->i", R[:-1], steps))


def _axes(up: Float, T_w_c: Float) -> Float:
    """Rows x ahead, y left, z up (3, 3).

    Ahead is the camera's axis at the start; the direction of travel, if that axis is vertical;
    the top of the picture, if the car stood too.
    """
    R, steps = T_w_c[:, :3, :3], np.diff(T_w_c[:, :3, 3], axis=0)
    ahead = R[0, :, 2]
    if _along(ahead, up):
        ahead = -R[0, :, 1]
        if steps.any():
            moved = R[0] @ _travel(R, steps)
            ahead = ahead if _along(moved, up) else moved
    x = _unit(ahead - (ahead @ up) * up)
    return np.stack([x, np.cross(up, x), up])


def _along(a: Float, b: Float) -> bool:
    """Whether two unit vectors are along one axis, within ALONG."""
    return bool(abs(a @ b) > np.cos(ALONG))


def _unit(v: Float) -> Float:
    """Unit vector of v (3,)."""
    return np.asarray(v / np.linalg.norm(v))
