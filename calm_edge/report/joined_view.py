"""Put the views of several drives into one map.html."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calm_edge.report.map_page import MapView

# s between the last keyframe of a drive and the first one of the next, on the slider's time
PAUSE_S = 1.0


def joined(title: str, names: Sequence[str], views: Sequence[MapView]) -> MapView:
    """One view of drives in a common frame; its times are those of the drives one after another.

    Unit and grain are those of the first view.
    """
    keyframe = np.cumsum([0, *(len(view.T_w_c) for view in views)])
    submap = np.cumsum([0, *(len(view.submap_s) for view in views)])
    lasts = [float(view.t_s[-1]) + PAUSE_S for view in views]
    start_s = np.cumsum([0.0, *lasts])
    each = list(zip(views, keyframe.tolist(), submap.tolist(), start_s.tolist(), strict=False))
    return replace(
        views[0],
        title=title,
        points_w=np.concatenate([view.points_w for view in views]),
        color=np.concatenate([view.color for view in views]),
        submap=np.concatenate([view.submap + first for view, _, first, _ in each]),
        submap_s=np.concatenate([view.submap_s + t for view, _, _, t in each]),
        T_w_c=np.concatenate([view.T_w_c for view in views]),
        t_s=np.concatenate([view.t_s + t for view, _, _, t in each]),
        pictures=[
            replace(picture, keyframe=picture.keyframe + k)
            for view, k, _, _ in each
            for picture in view.pictures
        ],
        seams=np.concatenate([view.seams for view in views]),
        events=[
            replace(event, keyframe=event.keyframe + k, text=f"{event.text} ({name})".strip())
            for name, (view, k, _, _) in zip(names, each, strict=True)
            for event in view.events
            if event.keyframe is not None
        ],
        drives=tuple(zip(names, keyframe.tolist(), strict=False)),
    )
