"""The paper's placement (IV-B) between two sub-maps, as an alignment to compare with."""

from __future__ import annotations

from bench.baselines.overlap import BaselineError, Correspondences, common_views
from calm_edge.estimator import scale
from calm_edge.geometry.similarity import Similarity
from calm_edge.types import Float, Submap


def place(previous: Submap, new: Submap, matches: Correspondences) -> Float:
    """T_previous_new (4, 4) = [[scale R, t], [0, 1]] between raw frames; raises BaselineError.

    The scale is the ratio of both sub-maps' scales by the camera spacing, the pose that of the
    first common picture; points are not used.
    """
    views_previous, views_new = common_views(previous, new)
    if not len(views_new):
        raise BaselineError("no common picture")
    ratio = new.scale / previous.scale
    T_s_f = scale.rectified(new.T_s_c_raw[views_new], ratio)
    T = scale.placement(previous.T_s_c_raw[views_previous], T_s_f)
    return Similarity(ratio, T[:3, :3], T[:3, 3]).matrix()
