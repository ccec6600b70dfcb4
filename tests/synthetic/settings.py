"""What decides a rendered drive; the two kits that have driven through the town."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.distortion import radial
from calm_edge.geometry.fisheye import Fisheye, angle_radial


@dataclass(frozen=True, slots=True)
class Settings:
    """Everything that decides a drive. Lengths m, angles degrees, times s, density texels/m.

    Pairs are of the primary and the assistant. hfov_deg: across the picture, through the lens.
    fisheye, distortion: model and coefficients of the lenses, as in `geometry`. centre_off: of the
    principal point, shares of the width. rotation_deg: rotation vector of the assistant in the
    primary's axes (pitch, yaw, roll). offset_m: its optical centre there, stretched to
    `spacing_m`. readout_s: from the exposure of the first row to that of the last; stamps are the
    middle row's. bonnet: share of the height that it hides. gain: brightness of the pictures,
    exposure_phase: rad, of its slow drift. oncoming, ahead: where other cars begin, shares of the
    round. overlap_m: how much of the first street is driven again at the end.
    """

    frames: int = 440
    width: int = 544
    height: int = 208
    seed: int = 0
    rate_hz: float = 10.0
    start_s: float = 0.0
    hfov_deg: tuple[float, float] = (78.0, 70.0)
    fisheye: tuple[bool, bool] = (False, False)
    distortion: tuple[tuple[float, ...], tuple[float, ...]] = ((), ())
    centre_off: tuple[tuple[float, float], tuple[float, float]] = ((0.0, 0.0), (0.0, 0.0))
    rotation_deg: tuple[float, float, float] = (1.2, -3.5, -1.5)
    offset_m: tuple[float, float, float] = (0.497, 0.018, 0.045)
    spacing_m: float = 0.5
    assistant_delay_s: float = 0.017
    readout_s: tuple[float, float] = (0.0, 0.0)
    bonnet: tuple[float, float] = (0.0, 0.0)
    oncoming: tuple[float, ...] = ()
    ahead: tuple[float, ...] = ()
    lens_blur_px: float = 0.65
    noise: float = 2.0
    gain: tuple[float, float] = (1.0, 1.0)
    exposure_drift: float = 0.07
    exposure_phase: tuple[float, float] = (0.0, 0.0)
    jpeg_quality: int = 85
    density: float = 48.0
    overlap_m: float = 32.0
    cloud_every: int = 4
    cloud_reach_m: float = 40.0
    cloud_voxel_m: float = 0.15
    cloud_points: int = 110_000


# what a first drive is tried on: pinholes, all rows exposed at once, nothing else moves
PLAIN = Settings()
# two ordinary cameras of different makes on one dashboard
REAL = replace(
    PLAIN,
    hfov_deg=(78.0, 110.0),
    fisheye=(False, True),
    distortion=((-0.13, 0.02), (-0.02, 0.004)),
    centre_off=((0.006, -0.004), (-0.008, 0.005)),
    readout_s=(0.020, 0.025),
    bonnet=(0.11, 0.14),
    oncoming=(0.30, 0.75),
    ahead=(0.05,),
    gain=(1.0, 1.08),
    exposure_drift=0.13,
    exposure_phase=(0.0, 1.7),
)
KITS = {"plain": PLAIN, "real": REAL}


def camera(settings: Settings, eye: int) -> Camera:
    """The camera of an eye."""
    width, height = settings.width, settings.height
    terms, half = settings.distortion[eye], np.radians(settings.hfov_deg[eye]) / 2
    plain = Perspective.from_hfov(settings.hfov_deg[eye], width, height)
    x, y = settings.centre_off[eye]
    plain = replace(plain, cx=plain.cx + x * width, cy=plain.cy + y * width)
    if not terms and not settings.fisheye[eye]:
        return plain
    square = np.array(np.tan(half) ** 2)
    bend = angle_radial(square, terms) if settings.fisheye[eye] else radial(square, terms)
    focal = plain.fx / float(bend[0])
    model = Fisheye if settings.fisheye[eye] else Perspective
    return model(focal, focal, plain.cx, plain.cy, width, height, terms)
