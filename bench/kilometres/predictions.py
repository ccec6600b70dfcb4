"""Cache of scripted predictions on disk, so that all variants use the same predictions."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.drives import ROOT
from bench.kilometres.drives import Drive
from bench.kilometres.sources import digest
from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.geometry.camera import Perspective
from calm_edge.types import Float32, Hints, Int, Landmarks, Prediction

CACHE = ROOT / "build" / "kilometres"


# Computed at import, so that editing the code during a long run does not change the file names.
_CODE = digest(("bench.scripted",))


class CachedBackbone:
    """Scripted backbone that caches the prediction of each window on disk."""

    def __init__(self, backbone: ScriptedBackbone, folder: Path) -> None:
        self._backbone, self._folder = backbone, folder
        folder.mkdir(parents=True, exist_ok=True)

    def infer(self, images: Sequence[NDArray[np.uint8]], hints: Hints) -> Prediction:
        """Return the scripted prediction, from the cache if possible."""
        file = self._folder / f"{_key(hints)}.npz"
        if file.is_file():
            return _read(file)
        prediction = self._backbone.infer(images, hints)
        _write(file, prediction)
        return prediction

    def densify(
        self, images: Sequence[NDArray[np.uint8]], hints: Hints, prediction: Prediction
    ) -> Prediction:
        """Add the scripted depth, which is not cached."""
        return self._backbone.densify(images, hints, prediction)

    def depth(self, hints: Hints, views: Int) -> tuple[Float32, Float32]:
        """Depth and confidence (V, h, w) of some views of a batch; not cached."""
        return self._backbone.depth(hints, views)


def cached(drive: Drive, dials: ScriptedErrors, folder: Path = CACHE) -> CachedBackbone:
    """Backbone with the predictions of a drive under errors, cached below `folder`.

    dials: sizes of the errors. The folder name has a hash of code, drive and errors, so that
    predictions of others are not used.
    """
    made_by = hashlib.sha256(f"{_CODE}{dials}".encode())
    scene = drive.scene
    made_by.update(repr(scene.cameras).encode())
    for array in (scene.t_ns, scene.T_w_p, scene.T_p_a):
        made_by.update(array.tobytes())
    for eye in scene.exposures or ():
        made_by.update(eye.stamp_ns.tobytes() + eye.t_ns.tobytes())
    name = f"{drive.name}_{dials.seed}_{made_by.hexdigest()[:12]}"
    return CachedBackbone(ScriptedBackbone(scene, dials), folder / name)


def _key(hints: Hints) -> str:
    key = hashlib.sha256(hints.eyes.tobytes() + hints.t_ns.tobytes())
    key.update(repr(hints.lenses).encode())
    return key.hexdigest()[:24]


def _write(file: Path, prediction: Prediction) -> None:
    """Write a prediction atomically, since several processes may share the folder."""
    optics = [(c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in prediction.cameras]
    arrays: dict[str, Any] = {"optics": np.array(optics), "T_s_c": prediction.T_s_c}
    arrays["loop_found"] = np.array(prediction.loop_found)
    if prediction.focal_log_sigma is not None:
        arrays["focal_log_sigma"] = prediction.focal_log_sigma
    if (marks := prediction.landmarks) is not None:
        arrays |= {
            "points_s": marks.points_s,
            "index": marks.index.astype(np.int32),
            "view": marks.view.astype(np.int16),
            "uv": marks.uv,
        }
    part = file.with_suffix(f".{os.getpid()}.part")
    with part.open("wb") as out:
        np.savez(out, **arrays)
    part.replace(file)


def _read(file: Path) -> Prediction:
    with np.load(file) as data:
        arrays = dict(data)
    landmarks = None
    if "uv" in arrays:
        landmarks = Landmarks(
            arrays["points_s"],
            arrays["index"].astype(np.int64),
            arrays["view"].astype(np.int64),
            arrays["uv"],
        )
    return Prediction(
        cameras=tuple(
            Perspective(*row[:4], *map(int, row[4:])) for row in arrays["optics"].tolist()
        ),
        T_s_c=arrays["T_s_c"],
        focal_log_sigma=arrays.get("focal_log_sigma"),
        landmarks=landmarks,
        loop_found=bool(arrays["loop_found"]),
    )
