"""`transforms.json` with its pictures, as NeRF and splat trainers read it.

Poses are camera to world with OpenGL's camera axes: x right, y up, z backward. Pixel centres are at
half pixels.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.interchange.calibration.colmap import model_of
from calm_edge.interchange.export.base import ExportOptions, Written
from calm_edge.interchange.export.drive import ExportedDrive
from calm_edge.interchange.export.scene import IMAGES, read_scene, write_pictures
from calm_edge.interchange.export.tum import described

FILE = "transforms.json"
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
# names of the parameters after fx, fy, cx, cy, by COLMAP's name of the model
_TERMS = {
    "PINHOLE": (),
    "OPENCV": ("k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4"),
    "FULL_OPENCV": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}


class Transforms:
    """`images/` and `transforms.json`, each picture with its own camera."""

    name = "transforms"
    writes = "transforms.json of NeRF and splat trainers, with pictures"

    def write(self, drive: ExportedDrive, folder: Path, options: ExportOptions) -> Written:
        """Write pictures and poses; raises InterchangeError."""
        scene = read_scene(drive, options)
        write_pictures(drive, scene, folder, options)
        frames = [
            {
                "file_path": f"{IMAGES}/{each.name}",
                "transform_matrix": (each.T_w_c @ OPENGL).tolist(),
                **lens(scene.cameras[each.eye]),
            }
            for each in scene.pictures
        ]
        (folder / FILE).write_text(json.dumps({"frames": frames}, indent=1) + "\n")
        return Written(
            (
                f"{IMAGES}: {len(scene.pictures)} of {len(scene.cameras)} cameras",
                f"{FILE}: their poses and cameras",
            ),
            (
                *described(drive)[1:],
                "poses are camera to world in OpenGL's axes, one for each picture, at its middle "
                "row: rolling shutter is not modelled; the world is the first keyframe, x right, "
                "y down, z forward",
                *scene.assumed,
            ),
            (*scene.left_out, "landmarks (--to colmap)"),
        )


def lens(camera: Camera) -> dict[str, Any]:
    """A camera in the keys of transforms.json."""
    model, _, (fx, fy, cx, cy, *terms) = model_of(camera)
    known = dict(zip(_TERMS[model], terms, strict=True))
    return {
        "camera_model": "OPENCV" if model == "FULL_OPENCV" else model,
        "w": camera.width,
        "h": camera.height,
        "fl_x": fx,
        "fl_y": fy,
        "cx": cx,
        "cy": cy,
        **known,
    }
