"""Corresponding 3-D points of two sub-maps: those at the same pixel of a common picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from calm_edge.geometry import se3
from calm_edge.types import CalmEdgeError, Float, Int, Landmarks, Prediction, Submap

STRIDE = 2
# VGGT-Long drops pixels below a tenth of the smaller of the two median confidences.
CONFIDENCE_SHARE = 0.1
# Each window detects corners anew: detections within this distance are the same point.
SAME_PIXEL_PX = 0.5


class BaselineError(CalmEdgeError):
    """A sub-map cannot be placed by a baseline."""


@dataclass(frozen=True, slots=True)
class Correspondences:
    """M corresponding points of two sub-maps.

    previous, new: (M, 3) each in its sub-map's frame and raw unit. weight: (M,) > 0, the geometric
    mean of both confidences.
    """

    previous: Float
    new: Float
    weight: Float

    def finite(self) -> Correspondences:
        """Keep the correspondences with finite values and positive weight."""
        all_columns = np.column_stack([self.previous, self.new, self.weight])
        keep = np.isfinite(all_columns).all(1) & (self.weight > 0)
        return Correspondences(self.previous[keep], self.new[keep], self.weight[keep])

    def unit(self) -> float:
        """Mean distance of the previous sub-map's points from its origin, raw unit.

        Thresholds published for normalised scenes are multiplied by it.
        """
        return float(np.linalg.norm(self.previous, axis=1).mean())


def common_views(previous: Submap, new: Submap) -> tuple[Int, Int]:
    """Batch indices (V,) of the common primary keyframes, in each of two sub-maps."""
    ids = [i for i in new.primary_ids if i in previous.primary_ids]
    return (
        np.array([previous.primary_ids.index(i) for i in ids], np.int64),
        np.array([new.primary_ids.index(i) for i in ids], np.int64),
    )


def loop_views(match: Submap, query: Submap, match_id: int) -> tuple[Int, Int]:
    """Batch indices (1,) of the one picture that both sub-maps of a loop closure have (IV-D).

    It is keyframe `match_id`: one of the primary views of `match`, and the last view of `query`, to
    whose window it was appended. Raises BaselineError if either sub-map lacks it.
    """
    last = query.n_primary + len(query.assistant_ids)
    if match_id not in match.primary_ids or last >= len(query.T_s_c_raw):
        raise BaselineError(f"keyframe {match_id} is not in sub-maps {match.id} and {query.id}")
    return np.array([match.primary_ids.index(match_id)]), np.array([last])


def correspondences(
    previous: Prediction,
    views_previous: Int,
    new: Prediction,
    views_new: Int,
    size: Int,
    stride: int = STRIDE,
) -> Correspondences:
    """Correspondences from depth maps if both predictions have them, else from landmarks.

    views_previous, views_new: (V,) batch indices of the same V pictures. size: (2,) width and
    height of the pictures, px. Empty without depth and landmarks. Raises BaselineError for depth
    without confidence.
    """
    if previous.depth is not None and new.depth is not None:
        return from_depth(previous, views_previous, new, views_new, size, stride)
    return from_landmarks(previous, views_previous, new, views_new)


def from_depth(
    previous: Prediction,
    views_previous: Int,
    new: Prediction,
    views_new: Int,
    size: Int,
    stride: int = STRIDE,
) -> Correspondences:
    """Back-project every `stride`-th depth pixel of the common pictures in both sub-maps.

    Left out: pixels without depth in either sub-map, and those with a confidence in either below
    CONFIDENCE_SHARE of the smaller of both sub-maps' median confidences. Depth maps of different
    sizes are sampled at the nearest pixel. Arguments as in `correspondences`; raises BaselineError
    without depth or confidence.
    """
    parts = [_none()]
    for view_previous, view_new in zip(views_previous, views_new, strict=True):
        height, width = _maps(previous)[0].shape[1:]
        y, x = np.mgrid[stride // 2 : height : stride, stride // 2 : width : stride]
        share = np.array([width, height]) / size
        uv = (np.stack([x, y], -1).reshape(-1, 2) + 0.5) / share - 0.5
        a, confidence_a = _lifted(previous, view_previous, uv, size)
        b, confidence_b = _lifted(new, view_new, uv, size)
        known = (confidence_a > 0) & (confidence_b > 0)
        if not known.any():
            continue
        medians = np.median(confidence_a[known]), np.median(confidence_b[known])
        keep = np.minimum(confidence_a, confidence_b) > CONFIDENCE_SHARE * min(medians)
        weight = np.sqrt(confidence_a * confidence_b)
        parts.append(Correspondences(a[keep], b[keep], weight[keep]))
    return _joined(parts)


def from_landmarks(
    previous: Prediction, views_previous: Int, new: Prediction, views_new: Int
) -> Correspondences:
    """Pair landmarks that are mutual nearest neighbours in a picture, within SAME_PIXEL_PX."""
    if previous.landmarks is None or new.landmarks is None:
        return _none()
    parts = [_none()]
    for view_previous, view_new in zip(views_previous, views_new, strict=True):
        a, uv_a = _seen(previous.landmarks, view_previous)
        b, uv_b = _seen(new.landmarks, view_new)
        if len(a) and len(b):
            distance, nearest = cKDTree(uv_b).query(uv_a)
            back = np.asarray(cKDTree(uv_a).query(uv_b)[1])
            nearest = np.asarray(nearest)
            mutual = back[nearest] == np.arange(len(a))
            (i,) = np.nonzero(mutual & (distance <= SAME_PIXEL_PX))
            parts.append(Correspondences(a[i], b[nearest[i]], np.ones(len(i))))
    return _joined(parts)


def _lifted(
    prediction: Prediction, view: int, uv: Float, size: Int
) -> tuple[Float, NDArray[np.float64]]:
    """Back-project pixels uv (M, 2) of a view to points (M, 3) in the sub-map frame.

    Also returns their confidence (M,), 0 where there is no depth. size: (2,) of the picture, px.
    """
    depth, confidence = _maps(prediction)
    height, width = depth.shape[1:]
    xy = np.rint((uv + 0.5) * (np.array([width, height]) / size) - 0.5).astype(np.int64)
    column, row = np.clip(xy, 0, [width - 1, height - 1]).T
    z = depth[view, row, column].astype(np.float64)
    known = np.isfinite(z) & (z > 0)
    z = np.where(known, z, 1.0)
    points = se3.transform(prediction.T_s_c[view], prediction.cameras[view].back_project(uv, z))
    return points, np.where(known, confidence[view, row, column], 0.0).astype(np.float64)


def _maps(prediction: Prediction) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    if prediction.depth is None or prediction.confidence is None:
        raise BaselineError("a prediction lacks depth or confidence")
    return prediction.depth, prediction.confidence


def _seen(landmarks: Landmarks, view: int) -> tuple[Float, Float]:
    """Points (M, 3) and pixels (M, 2) of the landmarks visible in one view."""
    here = landmarks.view == view
    return landmarks.points_s[landmarks.index[here]], landmarks.uv[here].astype(np.float64)


def _none() -> Correspondences:
    return Correspondences(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def _joined(parts: list[Correspondences]) -> Correspondences:
    return Correspondences(
        np.concatenate([part.previous for part in parts]),
        np.concatenate([part.new for part in parts]),
        np.concatenate([part.weight for part in parts]),
    )
