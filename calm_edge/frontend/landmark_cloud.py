"""World points of a placed sub-map, for localising frames against it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import picture_mask, se3
from calm_edge.geometry.camera import back_project_each
from calm_edge.geometry.flow import corners
from calm_edge.types import Bytes, Float, Float32, Int, LocalizerUpdate

# number of newest keyframes whose points are used; those of older ones are out of view
RECENT_VIEWS = 4
MIN_CONFIDENCE = 0.5
CORNERS = 600


@dataclass(frozen=True, slots=True)
class LandmarkCloud:
    """Points p_w (M, 3), world units, with their last observation uv (M, 2) in keyframe_id (M,)."""

    p_w: Float
    uv: Float32
    keyframe_id: Int


def of_update(update: LocalizerUpdate, count: int, gray: Bytes | None = None) -> LandmarkCloud:
    """At most `count` points of the newest keyframes, newest first.

    Each is back-projected from its last observation at its depth, consistent with the rectified
    pose and camera. Without landmarks: corners of `gray` (H, W), the image of the newest primary
    keyframe, at pixels of confident depth.
    """
    submap, prediction = update.submap, update.prediction
    first = max(0, submap.n_primary - RECENT_VIEWS)
    if prediction.landmarks is not None:
        marks = prediction.landmarks
        keep = (marks.view >= first) & (marks.view < submap.n_primary)
        index, view, uv = marks.index[keep], marks.view[keep], marks.uv[keep]
        # sort by view, newest first, and take the first observation of each landmark
        order = np.lexsort((index, -view))
        index, view, uv = index[order], view[order], uv[order]
        _, once = np.unique(index, return_index=True)
        once = np.sort(once)
        index, view, uv = index[once], view[once], uv[once]
        T_c_s = se3.inverse(submap.T_s_c_raw[view])
        depth = (T_c_s[:, :3, :3] @ marks.points_s[index][..., None])[:, 2, 0] + T_c_s[:, 2, 3]
    else:
        view, uv, depth = _from_depth(update, gray)
    front = np.isfinite(depth) & (depth > 0)
    mask = None if update.masks is None else update.masks.primary
    if mask is not None:
        camera = submap.cameras[0]
        front &= ~picture_mask.inside(mask, uv, (camera.width, camera.height))
    view, uv, depth = view[front], np.asarray(uv[front], np.float32), depth[front]
    step = max(1, -(-len(view) // count))
    view, uv, depth = view[::step], uv[::step], depth[::step] * submap.scale
    p_c = back_project_each(submap.cameras, view, uv.astype(np.float64), depth)
    T_w_c = submap.T_w_c()[view]
    p_w = (T_w_c[:, :3, :3] @ p_c[..., None])[..., 0] + T_w_c[:, :3, 3]
    ids = np.array(submap.primary_ids, np.int64)[view]
    return LandmarkCloud(p_w, uv, ids)


def _from_depth(update: LocalizerUpdate, gray: Bytes | None) -> tuple[Int, Float32, Float]:
    """View, pixels and raw depth of corners in the newest primary view; empty without depth."""
    prediction, view = update.prediction, update.submap.n_primary - 1
    if prediction.depth is None or gray is None:
        return np.zeros(0, np.int64), np.zeros((0, 2), np.float32), np.zeros(0)
    depth = prediction.depth[view].astype(np.float64)
    if prediction.confidence is not None:
        depth = np.where(prediction.confidence[view] >= MIN_CONFIDENCE, depth, 0.0)
    uv = corners(gray, CORNERS)
    scale = np.array([depth.shape[1] / gray.shape[1], depth.shape[0] / gray.shape[0]])
    column, row = ((uv + 0.5) * scale).astype(np.int64).T
    return np.full(len(uv), view, np.int64), uv, depth[row, column]
