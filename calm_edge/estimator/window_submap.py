"""One batch of pictures: the window it came of, what a backbone said of it, and its sub-map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.types import (
    Bytes,
    Float,
    Hints,
    Int,
    Prediction,
    Submap,
    SubmapWindow,
)
from device.frame import Eye


def raw_submap(window: SubmapWindow, hints: Hints, prediction: Prediction) -> Submap:
    """The window as a sub-map, neither rectified nor placed."""
    return Submap(
        id=window.submap_id,
        primary_ids=tuple(keyframe.id for keyframe in window.primary),
        assistant_ids=tuple(keyframe.id for keyframe in window.assistant),
        n_overlap=window.n_overlap,
        t_ns=hints.t_ns,
        T_s_c_raw=prediction.T_s_c,
        cameras_raw=prediction.cameras,
        T_s_c=prediction.T_s_c,
        cameras=prediction.cameras,
        scale=1.0,
        T_w_s=np.eye(4),
        focal_log_sigma=_focal_log_sigma(len(window.primary), prediction),
        assistant_late_ns=round(prediction.assistant_late_s * 1e9),
        stamps_off_ns=_stamps_off_ns(prediction),
    )


def solved_again(submap: Submap, prediction: Prediction | None) -> Submap:
    """The sub-map with a later prediction's raw poses and cameras."""
    if prediction is None:
        return submap
    return replace(
        submap,
        T_s_c_raw=prediction.T_s_c,
        cameras_raw=prediction.cameras,
        focal_log_sigma=_focal_log_sigma(submap.n_primary, prediction),
        assistant_late_ns=round(prediction.assistant_late_s * 1e9),
        stamps_off_ns=_stamps_off_ns(prediction),
    )


def sizes(window: SubmapWindow, images: list[Bytes]) -> Int | None:
    """(2, 2) width and height [px] of each eye's pictures, None without an assistant."""
    if not window.assistant:
        return None
    shapes = [images[0].shape, images[len(window.primary)].shape]
    return np.array([[shape[1], shape[0]] for shape in shapes], np.int64)


def _stamps_off_ns(prediction: Prediction) -> Int | None:
    off_s = prediction.stamps_off_s
    return None if off_s is None else np.round(off_s * 1e9).astype(np.int64)


def _focal_log_sigma(n_primary: int, prediction: Prediction) -> Float:
    """(2,) an eye; inf where the model does not know its focal's error."""
    sigma = prediction.focal_log_sigma
    if sigma is None or len(sigma) <= n_primary:
        return np.full(len(Eye), np.inf)
    return np.asarray(sigma[[0, n_primary]])


def without_loop(
    prediction: Prediction, submap: Submap, hints: Hints
) -> tuple[Prediction, Submap, Hints]:
    """All three without the trailing loop view, which told nothing that is believed."""
    n = len(hints.eyes) - 1
    marks = prediction.landmarks
    if marks is not None:
        kept = marks.view < n
        index, view, uv = marks.index[kept], marks.view[kept], marks.uv[kept]
        sigma_px = None if marks.sigma_px is None else marks.sigma_px[kept]
        marks = replace(marks, index=index, view=view, uv=uv, sigma_px=sigma_px)
    cut = replace(
        prediction,
        cameras=prediction.cameras[:n],
        T_s_c=prediction.T_s_c[:n],
        depth=None if prediction.depth is None else prediction.depth[:n],
        confidence=None if prediction.confidence is None else prediction.confidence[:n],
        focal_log_sigma=_first(prediction.focal_log_sigma, n),
        landmarks=marks,
        loop_found=True,
    )
    bare = replace(
        submap,
        t_ns=submap.t_ns[:n],
        T_s_c_raw=submap.T_s_c_raw[:n],
        cameras_raw=submap.cameras_raw[:n],
        T_s_c=submap.T_s_c[:n],
        cameras=submap.cameras[:n],
    )
    return cut, bare, replace(hints, eyes=hints.eyes[:n], t_ns=hints.t_ns[:n], loop=False)


def _first(values: Float | None, n: int) -> Float | None:
    return None if values is None else values[:n]
