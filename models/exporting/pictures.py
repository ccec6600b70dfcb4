"""Load images for golden values and for calibration of int8."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SUFFIXES = {".png", ".jpg", ".jpeg"}


def pictures(folder: Path | None, size: tuple[int, int], count: int) -> NDArray[np.uint8]:
    """Images (count, H, W, 3), BGR, resized to (width, height) px, sorted by name.

    Without a folder they are synthetic. Exits with a message of one line if there are too few.
    """
    if folder is None:
        return _painted(size, count)
    files = sorted(path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES)
    found = [image for path in files[:count] if (image := cv2.imread(str(path))) is not None]
    if len(found) < count:
        raise SystemExit(f"{folder}: {len(found)} images, but {count} are needed")
    return np.stack([cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in found])


def normalised(shown: NDArray[np.uint8], spec: Mapping[str, Any]) -> NDArray[np.float32]:
    """Input tensor (1, N, 3, H, W), RGB, normalised by `spec`, the manifest's `[input]`."""
    values = shown[..., ::-1].astype(np.float32) / np.float32(255)
    mean, std = (np.asarray(spec.get(key, [d]), np.float32) for key, d in (("mean", 0), ("std", 1)))
    values = (values - mean) / std
    return np.ascontiguousarray(values.transpose(0, 3, 1, 2)[None], np.float32)


def _painted(size: tuple[int, int], count: int) -> NDArray[np.uint8]:
    """Smooth random pattern that shifts from view to view; it shows no consistent scene."""
    rng = np.random.default_rng(0)
    width, height = size
    coarse = rng.random((8, 12, 3)).astype(np.float32)
    wide = cv2.resize(coarse, (width * 2, height), interpolation=cv2.INTER_CUBIC)
    fine = np.asarray(rng.random(wide.shape), np.float32) * 0.2
    step = width // max(count, 1)
    views = [(wide + fine)[:, i * step : i * step + width] for i in range(count)]
    return np.asarray((np.stack(views) * 200).clip(0, 255), np.uint8)
