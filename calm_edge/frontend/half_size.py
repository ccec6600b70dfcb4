"""Pictures too large to track every one of are tracked at half their size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.types import LocalizerUpdate

# corners and pyramids cost by the pixel: of 1280x720, thirty times a second, more than a core has
MOST_PIXELS = 600_000
# the centre of the first of every two pixels is half a pixel from the first one's own
_HALF = np.array([[0.5, 0.0, -0.25], [0.0, 0.5, -0.25], [0.0, 0.0, 1.0]])


def halved(update: LocalizerUpdate) -> LocalizerUpdate:
    """The same sub-map as its pictures at half their size show it; poses stay."""
    submap, prediction = update.submap, update.prediction
    marks = prediction.landmarks
    if marks is not None:
        uv = np.asarray((marks.uv + 0.5) / 2 - 0.5, np.float32)
        sigma_px = None if marks.sigma_px is None else marks.sigma_px / np.float32(2)
        marks = replace(marks, uv=uv, sigma_px=sigma_px)
    prediction = replace(prediction, K=_HALF @ prediction.K, landmarks=marks)
    submap = replace(submap, K=_HALF @ submap.K, K_raw=_HALF @ submap.K_raw)
    return replace(update, submap=submap, prediction=prediction)
