"""Pictures for golden values and calibration."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SUFFIXES = {".png", ".jpg", ".jpeg"}


def pictures(folder: Path | None, size: tuple[int, int], count: int) -> NDArray[np.uint8]:
    """(count, H, W, 3) BGR of (width, height) px, in order of name; without a folder, painted.

    Exits with one line when there are too few.
    """
    if folder is None:
        return _painted(size, count)
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES)
    found = [image for path in files[:count] if (image := cv2.imread(str(path))) is not None]
    if len(found) < count:
        raise SystemExit(f"{folder}: {len(found)} pictures; {count} are needed")
    return np.stack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in found])


def normalised(shown: NDArray[np.uint8], spec: Mapping[str, Any]) -> NDArray[np.float32]:
    """(1, N, 3, H, W) RGB, as `spec`, the manifest's `[input]`, says and calm-edge does it."""
    values = shown[..., ::-1].astype(np.float32) / np.float32(255)
    mean, std = (np.asarray(spec.get(key, [d]), np.float32) for key, d in (("mean", 0), ("std", 1)))
    values = (values - mean) / std
    return np.ascontiguousarray(values.transpose(0, 3, 1, 2)[None], np.float32)


def _painted(size: tuple[int, int], count: int) -> NDArray[np.uint8]:
    """A soft random pattern that moves from view to view; no scene, but no noise either."""
    rng = np.random.default_rng(0)
    width, height = size
    coarse = rng.random((8, 12, 3)).astype(np.float32)
    wide = cv2.resize(coarse, (width * 2, height), interpolation=cv2.INTER_CUBIC)
    fine = np.asarray(rng.random(wide.shape), np.float32) * 0.2
    step = width // max(count, 1)
    views = [(wide + fine)[:, i * step : i * step + width] for i in range(count)]
    return np.asarray((np.stack(views) * 200).clip(0, 255), np.uint8)
