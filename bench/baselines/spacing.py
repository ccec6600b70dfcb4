"""Placement of the paper (IV-B): align sub-maps by camera spacing and one common picture."""

from __future__ import annotations

from bench.baselines.overlap import BaselineError, Correspondences, common_views
from calm_edge.estimator import scale
from calm_edge.geometry.similarity import Similarity
from calm_edge.types import Float, Submap


def place(previous: Submap, new: Submap, matches: Correspondences) -> Float:
    """Compute T_previous_new (4, 4) = [[scale R, t], [0, 1]] between raw frames.

    The scale is the ratio of the scales that both sub-maps have from the camera spacing; the pose
    is that of the first common picture. `matches` is not used. Raises BaselineError without a
    common picture.
    """
    views_previous, views_new = common_views(previous, new)
    if not len(views_new):
        raise BaselineError("the sub-maps have no common picture")
    ratio = new.scale / previous.scale
    T_s_f = scale.rectified(new.T_s_c_raw[views_new], ratio)
    T = scale.placement(previous.T_s_c_raw[views_previous], T_s_f)
    return Similarity(ratio, T[:3, :3], T[:3, 3]).matrix()
