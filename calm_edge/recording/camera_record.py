"""Encode cameras as JSON for the header of a record; convert the matrices of version 0.1.0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from functools import lru_cache
from typing import Any

from calm_edge.geometry.camera import Camera, Perspective
from calm_edge.geometry.fisheye import Fisheye
from calm_edge.geometry.through_lens import ThroughLens
from calm_edge.recording import RecordingError
from device.frame import Eye

MODELS: dict[str, type[Camera]] = {
    "perspective": Perspective,
    "fisheye": Fisheye,
    "through lens": ThroughLens,
}
# names of the intrinsics arrays (N, 3, 3) px of version 0.1.0 -> fields that replace them
_MATRICES = {
    "prediction.K": "prediction.cameras",
    "submap.K_raw": "submap.cameras_raw",
    "submap.K": "submap.cameras",
}


def encode(camera: Camera) -> dict[str, Any]:
    """Encode a camera as the name of its model and all its fields; floats are stored exactly."""
    model = next(name for name, kind in MODELS.items() if isinstance(camera, kind))
    found = {field.name: getattr(camera, field.name) for field in fields(camera)}
    if isinstance(camera, ThroughLens):
        found["lens"] = encode(camera.lens)
    return {"model": model, **found}


def decode(value: Any) -> Camera:
    """Decode a camera of `encode`; raises RecordingError."""
    try:
        known = dict(value)
        model, distortion = known.pop("model"), tuple(known.pop("distortion"))
        if "lens" in known:
            known["lens"] = decode(known["lens"])
        return _camera(model, distortion, tuple(known.items()))
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(f"camera {value!r}: not a valid camera record ({error})") from None


@lru_cache
def _camera(
    model: str, distortion: tuple[float, ...], others: tuple[tuple[str, Any], ...]
) -> Camera:
    """The camera with these fields, one for all views of an eye."""
    return MODELS[model](**dict(others), distortion=distortion)


def replace_matrices(
    header: dict[str, Any], arrays: dict[str, Any], size_of: Callable[[Eye], tuple[int, int]]
) -> None:
    """Convert the 3x3 intrinsics in an update of version 0.1.0 to pinhole cameras, in place.

    size_of: returns width, height [px] of an eye's images; called only if there are matrices.
    """
    n, m = (len(header.get(f"submap.{eye}_ids", ())) for eye in ("primary", "assistant"))
    for name, field in _MATRICES.items():
        if name in arrays:
            sizes = [size_of(Eye(n <= view < n + m)) for view in range(len(arrays[name]))]
            each = zip(arrays.pop(name), sizes, strict=True)
            header[field] = [encode(Perspective.from_matrix(K, *size)) for K, size in each]
