"""Layout of the kit vector theta, its prior, and its drift between two drives.

theta (SIZE,): for each eye log(f / width), the principal point's offset from the image centre as a
share of the width (x, y), the terms of the lens (k1, k2, see `kit/lens`) and the readout time: from
the exposure of the first row to that of the last [s], 0 for a global shutter; then the rig T_p_a
as a rotation vector [rad] and the assistant's centre in the primary camera [spacings]; then the
time offset: how much later than its stamp, on the primary's clock, an assistant's picture is
exposed [s]; then the family of each eye's lens, a constant. Stamps and poses are those of the
middle row. This file alone holds the index of a term; elsewhere terms are named.
"""

from __future__ import annotations

import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.kit.belief import blurred
from calm_edge.kit.lens import Family, Lens
from calm_edge.types import Float, Int, KitBelief

# Indices into theta: the terms of each eye (2, terms), its optics and its shutter; then single
# terms of both eyes. The primary's come first, so its indices are also those within one eye.
EYE = np.arange(12).reshape(2, 6)
OPTICS, READOUT = EYE[:, :5], EYE[:, 5]
LOG_FOCAL = OPTICS[:, 0]
PRINCIPAL_POINT = OPTICS[:, 1:3]
DISTORTION = OPTICS[:, 3:]
RIG_ROTATION = slice(EYE.size, EYE.size + 3)
RIG_CENTRE = slice(RIG_ROTATION.stop, RIG_ROTATION.stop + 3)
RIG = slice(RIG_ROTATION.start, RIG_CENTRE.stop)
TIME_OFFSET = RIG.stop
FAMILY = TIME_OFFSET + np.array([1, 2])
SIZE = int(FAMILY[-1]) + 1

# Mean and sigmas of the prior. Phone, dashboard and web cameras have fields of view of 45 to 110
# degrees; the middle of log(f / width) is at 73 degrees. HINTED: for a field of view that was
# configured, e.g. from a data sheet.
DEFAULT_HFOV_DEG = 73.0
LOG_FOCAL_SIGMA = 0.30
HINTED_LOG_FOCAL_SIGMA = 0.01
PRINCIPAL_POINT_SIGMA = 0.02
# Lenses of phone, dashboard and web cameras have k1 of -0.3 to 0.05. Where k1 bends the picture, k2
# bends it back: the mean of k2 is this multiple of k1, its sigma given k1 the second of these.
RADIAL_SIGMA = np.array([0.15, 0.05])
RADIAL_RATIO = -0.25
# Of wide lenses: between 110 and 140 degrees across. Their terms are about those of the usual
# projections: stereographic (1/12, 1/120), equidistant (0, 0), equisolid (-1/24, 1/1920).
WIDE_HFOV_DEG = 125.0
WIDE_LOG_FOCAL_SIGMA = 0.25
ANGLE_MEAN = np.array([0.02, 0.0])
ANGLE_SIGMA = np.array([0.08, 0.03])
FAMILY_SIGMA = 1e-3
RIG_ROTATION_SIGMA_RAD = 0.5
RIG_DIRECTION_SIGMA = 1.0
SPACING_SIGMA = 1e-4
EVIDENCE_SPACING_SIGMA = 0.05
# Stamps are times of arrival, so two cameras of one type differ by less than a frame. At constant
# velocity the time offset and the rig's forward offset cannot be separated; this prior divides
# the sum between them.
TIME_OFFSET_SIGMA_S = 0.01
# Sensors read their rows out within 8 to 33 ms, or at once. HINTED: for a readout time that was
# configured.
READOUT_S, READOUT_SIGMA_S = 0.01, 0.012
HINTED_READOUT_SIGMA_S = 0.5e-3

# Largest sigmas of the rig's rotation [rad] and of the log focals at which the kit counts as known:
# matches between the cameras are then guided by it, and other focals need not be tried.
RIG_KNOWN_RAD = 0.02
FOCAL_KNOWN = 0.05
KIT_KNOWN = np.array([RIG_KNOWN_RAD, FOCAL_KNOWN])

# Sigmas of the drift between two drives of an untouched kit.
# Log focal: temperature, refocusing, and model errors that differ from road to road.
LOG_FOCAL_DRIFT = 0.015
# A lens shifts in its mount by some pixels.
PRINCIPAL_POINT_DRIFT = 0.003
RADIAL_DRIFT = np.array([0.002, 0.002])
# 0.3 degrees: vibration, and a windscreen that warms up
RIG_ROTATION_DRIFT_RAD = 0.005
# 5 mm for cameras half a metre apart
RIG_CENTRE_DRIFT = 0.01
# large: the time offset of one drive does not predict that of the next
TIME_OFFSET_DRIFT_S = 1.0
# set by the sensor's clock: the same while the video mode is
READOUT_DRIFT_S = 1e-4
FAMILY_DRIFT = 1e-4

Families = tuple[Family, Family]
PERSPECTIVE = Family.PERSPECTIVE, Family.PERSPECTIVE


def _vector(
    log_focal: float,
    principal_point: float,
    radial: Float,
    rotation: float,
    centre: float,
    time_offset: float,
    readout: float,
    family: float,
) -> Float:
    """Fill a vector (SIZE,) from one value for each kind of term, equal for both eyes."""
    out = np.empty(SIZE)
    out[LOG_FOCAL], out[PRINCIPAL_POINT], out[DISTORTION] = log_focal, principal_point, radial
    out[RIG_ROTATION], out[RIG_CENTRE], out[TIME_OFFSET] = rotation, centre, time_offset
    out[READOUT] = readout
    out[FAMILY] = family
    return out


def prior(
    hfov_deg: tuple[float | None, float | None],
    sizes: Int | None = None,
    readout_s: tuple[float | None, float | None] = (None, None),
    families: Families = PERSPECTIVE,
) -> KitBelief:
    """Prior belief; hfov_deg: horizontal field of view of each eye, None where unknown.

    sizes: (2, 2) width, height [px]: an unknown field of view is that of the long side. readout_s:
    of each eye, None where unknown.
    """
    mean = np.zeros(SIZE)
    sigma = _vector(
        LOG_FOCAL_SIGMA, PRINCIPAL_POINT_SIGMA, RADIAL_SIGMA,
        RIG_ROTATION_SIGMA_RAD, RIG_DIRECTION_SIGMA, TIME_OFFSET_SIGMA_S, READOUT_SIGMA_S,
        FAMILY_SIGMA,
    )  # fmt: skip
    mean[FAMILY] = families
    # rows whose products with the kit are independent: k2 is not independent of k1
    rows = np.eye(SIZE)
    for eye, (hfov, family) in enumerate(zip(hfov_deg, families, strict=True)):
        wide = family is Family.FISHEYE
        half = np.radians(hfov or (WIDE_HFOV_DEG if wide else DEFAULT_HFOV_DEG)) / 2
        width_over_f = 2 * (half if wide else np.tan(half))
        if not hfov and sizes is not None:
            width_over_f *= sizes[eye, 0] / max(sizes[eye])
        mean[LOG_FOCAL[eye]] = -np.log(width_over_f)
        k1, k2 = DISTORTION[eye]
        if wide:
            mean[[k1, k2]], sigma[[k1, k2]] = ANGLE_MEAN, ANGLE_SIGMA
            sigma[LOG_FOCAL[eye]] = WIDE_LOG_FOCAL_SIGMA
        else:
            rows[k2, k1] = -RADIAL_RATIO
        if hfov:
            sigma[LOG_FOCAL[eye]] = HINTED_LOG_FOCAL_SIGMA
    for index, readout in zip(READOUT, readout_s, strict=True):
        mean[index] = READOUT_S if readout is None else readout
        if readout is not None:
            sigma[index] = HINTED_READOUT_SIGMA_S
    rows /= sigma[:, None]
    return KitBelief(mean=mean, information=rows.T @ rows)


def drift_sigma() -> Float:
    """(SIZE,) one sigma of each term's change between two drives."""
    return _vector(
        LOG_FOCAL_DRIFT, PRINCIPAL_POINT_DRIFT, RADIAL_DRIFT,
        RIG_ROTATION_DRIFT_RAD, RIG_CENTRE_DRIFT, TIME_OFFSET_DRIFT_S, READOUT_DRIFT_S,
        FAMILY_DRIFT,
    )  # fmt: skip


def families(theta: Float) -> Families:
    """Family of each eye's lens."""
    primary, assistant = (Family(value > 0.5) for value in theta[FAMILY].tolist())
    return primary, assistant


def of_lens(belief: KitBelief) -> tuple[bool, bool]:
    """Whether a belief holds anything of each eye's lens; else its family means nothing."""
    primary, assistant = np.diag(belief.information)[LOG_FOCAL] > 0
    return bool(primary), bool(assistant)


def with_known_families(information: Float, known: tuple[bool, bool] = (True, True)) -> Float:
    """Information (SIZE, SIZE) of a belief that knows the families of its lenses.

    So that in products these are those of the beliefs that know them.
    """
    out = information.copy()
    which = FAMILY[list(known)]
    out[which, which] = FAMILY_SIGMA**-2.0
    return out


def alike(one: KitBelief, other: KitBelief) -> bool:
    """Whether two beliefs have a product: all lenses that both know are of the same family."""
    pairs = zip(families(one.mean), families(other.mean), strict=True)
    both = zip(of_lens(one), of_lens(other), strict=True)
    return all(a is b or not (x and y) for (a, b), (x, y) in zip(pairs, both, strict=True))


def lenses(theta: Float) -> tuple[Lens, Lens]:
    """Lens of each eye."""
    k = theta[DISTORTION].tolist()
    primary, assistant = families(theta)
    return Lens(primary, tuple(k[0])), Lens(assistant, tuple(k[1]))


def cameras(theta: Float, size: Int) -> tuple[Camera, Camera]:
    """Camera of each eye. size: (2, 2) width, height [px]. Raises FieldTooWide."""
    return camera(theta, 0, *size[0].tolist()), camera(theta, 1, *size[1].tolist())


def camera(theta: Float, eye: int, width: int, height: int) -> Camera:
    """Camera of an eye for pictures of width x height px; raises FieldTooWide."""
    f = float(np.exp(theta[LOG_FOCAL[eye]]) * width)
    cx, cy = (theta[PRINCIPAL_POINT[eye]] * width).tolist()
    centre = (width - 1) / 2 + cx, (height - 1) / 2 + cy
    return lenses(theta)[eye].camera(f, *centre, width, height)


def rig(theta: Float) -> Float:
    """T_p_a (4, 4), spacings."""
    return se3.compose(se3.so3_exp(theta[RIG_ROTATION]), theta[RIG_CENTRE])


def rig_vector(T_p_a: Float) -> Float:
    """The rig part (6,) of theta of a T_p_a, its length brought to one spacing."""
    t = T_p_a[:3, 3]
    return np.concatenate([se3.so3_log(T_p_a[:3, :3]), t / np.linalg.norm(t)])


def with_time_jitter(belief: KitBelief, sigma_s: float) -> KitBelief:
    """Add sigma_s^2 to the variance of the time offset."""
    return blurred(belief, np.eye(SIZE)[TIME_OFFSET], sigma_s)
