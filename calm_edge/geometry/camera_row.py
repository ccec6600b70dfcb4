"""The row of a camera in the calib.txt of a sequence folder.

    fx fy cx cy width height [perspective|fisheye k1 k2 ...]

Pixels; without a model a pinhole. The coefficients are those of `Perspective` and `Fisheye`.
"""

from __future__ import annotations

from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye

MODELS: dict[str, type[Perspective] | type[Fisheye]] = {
    "perspective": Perspective,
    "fisheye": Fisheye,
}
EXPECTED = "`fx fy cx cy width height` with an optional lens `perspective|fisheye k1 k2 ...`"
# coefficients that a model has at most
MOST_TERMS = {"perspective": 8, "fisheye": 4}


def camera_row(camera: Camera) -> str:
    """Format a camera, to nine digits."""
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    words = [f"{v:.9g}" for v in numbers]
    if not camera.is_pinhole:
        words.append("fisheye" if isinstance(camera, Fisheye) else "perspective")
        words += [f"{k:.9g}" for k in camera.distortion]
    return " ".join(words)


def parsed_camera(line: str) -> Camera:
    """Camera of a row; raises ValueError for a malformed one."""
    numbers, model, terms = line.split()[:6], line.split()[6:7], line.split()[7:]
    fx, fy, cx, cy, width, height = (float(v) for v in numbers)
    name = model[0] if model else "perspective"
    if name not in MODELS or len(terms) > MOST_TERMS[name]:
        raise ValueError(f"no lens: {' '.join([*model, *terms])}")
    distortion = tuple(float(k) for k in terms)
    return MODELS[name](fx, fy, cx, cy, int(width), int(height), distortion)
