"""The kit as a vector: the optics of both eyes and the rig between them, with a prior.

theta (15,): for each eye log(f / width), principal point offset from the image centre as a
share of the width (x, y), one radial term (p_distorted = p (1 + k1 r^2)); then the rig T_p_a as
a rotation vector [rad] and the assistant's centre in the primary camera [spacings]; then how much
later than its stamp, against the primary's, an assistant's picture was exposed [s].
"""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import pinhole, se3
from calm_edge.types import Float, KitBelief

SIZE = 15
OPTICS = (slice(0, 4), slice(4, 8))
RIG = slice(8, 14)
CENTRE = slice(11, 14)
LATE = 14
LOG_FOCAL = (0, 4)

# The prior's one-sigmas. A phone, dash or web camera sees 45 to 110 degrees: log f/W has its
# middle near 73 degrees. A hint is a data sheet's number.
DEFAULT_HFOV_DEG = 73.0
LOG_FOCAL_SIGMA = 0.30
HINTED_LOG_FOCAL_SIGMA = 0.01
CENTRE_SIGMA = 0.02
RADIAL_SIGMA = 0.0003
RIG_ROTATION_SIGMA_RAD = 0.5
RIG_DIRECTION_SIGMA = 1.0
SPACING_SIGMA = 1e-4
EVIDENCE_SPACING_SIGMA = 0.05
# Host clocks stamp what has arrived: two cameras of one kind differ by less than a frame. At
# constant velocity lateness and the rig's forward offset are one, and this prior divides them.
LATE_SIGMA_S = 0.01


def prior(hfov_deg: tuple[float | None, float | None]) -> KitBelief:
    """What is known of a kit before its first picture: a hint of the field of view at most."""
    mean = np.zeros(SIZE)
    sigma = np.empty(SIZE)
    for optics, hfov in zip(OPTICS, hfov_deg, strict=True):
        width_over_f = 2 * np.tan(np.radians(hfov or DEFAULT_HFOV_DEG) / 2)
        mean[optics] = [-np.log(width_over_f), 0, 0, 0]
        focal_sigma = HINTED_LOG_FOCAL_SIGMA if hfov else LOG_FOCAL_SIGMA
        sigma[optics] = [focal_sigma, CENTRE_SIGMA, CENTRE_SIGMA, RADIAL_SIGMA]
    sigma[8:11], sigma[CENTRE] = RIG_ROTATION_SIGMA_RAD, RIG_DIRECTION_SIGMA
    sigma[LATE] = LATE_SIGMA_S
    return KitBelief(mean=mean, information=np.diag(sigma**-2.0))


def camera_matrix(theta: Float, eye: int, width: int, height: int) -> Float:
    """K (3, 3) px of an eye of which the images are width x height."""
    log_f, cx, cy, _ = theta[OPTICS[eye]]
    f = np.exp(log_f) * width
    return pinhole.matrix(f, f, (width - 1) / 2 + cx * width, (height - 1) / 2 + cy * width)


def rig(theta: Float) -> Float:
    """T_p_a (4, 4), spacings."""
    return se3.compose(se3.so3_exp(theta[8:11]), theta[CENTRE])


def rig_vector(T_p_a: Float) -> Float:
    """The rig part (6,) of theta of a T_p_a, its length brought to one spacing."""
    t = T_p_a[:3, 3]
    return np.concatenate([se3.so3_log(T_p_a[:3, :3]), t / np.linalg.norm(t)])


def blurred(belief: KitBelief, late_s: float) -> KitBelief:
    """The belief where the lateness of one window is off the kit's by late_s, one sigma."""
    if late_s <= 0:
        return belief
    column = belief.information[:, LATE]
    known = column[LATE] + late_s**-2
    return KitBelief(belief.mean, belief.information - np.outer(column, column) / known)
