"""Assemble what map.html shows of a drive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calm_edge.evaluation.estimate import Estimate
from calm_edge.mapping.seams import Seam
from calm_edge.report.account import unit
from calm_edge.report.events import MarkedEvent
from calm_edge.report.keyframe_pictures import KeyframePictures
from calm_edge.report.map_page import MapView
from calm_edge.types import Bytes, Int, Submap


def map_view(
    title: str,
    estimate: Estimate,
    color: Bytes,
    tiles: Int,
    submaps: Sequence[Submap],
    origin_ns: int,
    grain: float,
    pictures: Sequence[KeyframePictures] = (),
    seams: Sequence[Seam] = (),
    events: Sequence[MarkedEvent] = (),
) -> MapView:
    """The page's content; points and poses are those of the estimate, whose stamps begin at origin.

    color: (P, 3) RGB of the points. tiles: rows (sub-map id, number of points), in the order of the
    points. The time of a sub-map is the mean stamp of its views, 0 at the first keyframe.
    """
    assert estimate.points_w is not None
    start = int(estimate.t_ns[0]) + origin_ns
    seconds = {s.id: float(np.mean(s.t_ns - start)) / 1e9 for s in submaps}
    return MapView(
        title,
        unit(estimate),
        grain,
        estimate.points_w,
        color,
        np.repeat(np.arange(len(tiles)), tiles[:, 1]),
        np.array([seconds[i] for i in tiles[:, 0].tolist()]),
        estimate.T_w_c,
        (estimate.t_ns - estimate.t_ns[0]) / 1e9,
        pictures,
        np.concatenate([np.zeros((0, 4), np.float32), *(seam.marks for seam in seams)]),
        events=events,
    )
