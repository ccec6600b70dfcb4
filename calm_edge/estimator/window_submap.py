"""Convert between windows, predictions and unplaced sub-maps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from calm_edge.estimator.gaps import cuts
from calm_edge.types import (
    Bytes,
    Hints,
    Int,
    Prediction,
    Submap,
    SubmapWindow,
)
from device.frame import Eye


def raw_submap(window: SubmapWindow, hints: Hints, prediction: Prediction) -> Submap:
    """Create a sub-map of a window, neither rectified nor placed."""
    submap = Submap(
        id=window.submap_id,
        primary_ids=tuple(keyframe.id for keyframe in window.primary),
        assistant_ids=tuple(keyframe.id for keyframe in window.assistant),
        n_overlap=window.n_overlap,
        t_ns=hints.t_ns,
        T_s_c=prediction.T_s_c,
        cameras=prediction.cameras,
        scale=1.0,
        T_w_s=np.eye(4),
        **_raw_fields(prediction, len(window.primary)),
    )
    return replace(submap, cuts=cuts(submap, prediction.landmarks))


def solved_again(submap: Submap, prediction: Prediction | None) -> Submap:
    """Replace the raw poses and cameras of a sub-map by those of a later prediction, if any."""
    if prediction is None:
        return submap
    later = replace(submap, **_raw_fields(prediction, submap.n_primary))
    return replace(later, cuts=cuts(later, prediction.landmarks))


def sizes(window: SubmapWindow, images: list[Bytes]) -> Int | None:
    """Width and height (2, 2) [px] of each camera's images; None without an assistant image."""
    if not window.assistant:
        return None
    shapes = [images[0].shape, images[len(window.primary)].shape]
    return np.array([[shape[1], shape[0]] for shape in shapes], np.int64)


def _raw_fields(prediction: Prediction, n_primary: int) -> dict[str, Any]:
    """Fields of a sub-map that come from the prediction; an unknown sigma is inf."""
    sigma, off_s = prediction.focal_log_sigma, prediction.stamps_off_s
    scale_sigma = prediction.scale_log_sigma
    focal = np.full(len(Eye), np.inf)
    if sigma is not None and len(sigma) > n_primary:
        focal = sigma[[0, n_primary]]
    return {
        "T_s_c_raw": prediction.T_s_c,
        "cameras_raw": prediction.cameras,
        "focal_log_sigma": focal,
        "scale_log_sigma": np.inf if scale_sigma is None else scale_sigma,
        "drawn": prediction.drawn,
        "assistant_late_ns": round(prediction.assistant_late_s * 1e9),
        "stamps_off_ns": None if off_s is None else np.round(off_s * 1e9).astype(np.int64),
    }
