"""The cameras as estimated after a window: the lenses and shutters that the kit has learned."""

from __future__ import annotations

import numpy as np

from calm_edge.geometry.camera import Camera
from calm_edge.geometry.through_lens import lens_of
from calm_edge.kit import layout
from calm_edge.kit.belief import product
from calm_edge.kit.observed import MAX_LOG_FOCAL_SIGMA
from calm_edge.types import Float, Int, LocalizerUpdate, Submap
from device.frame import Eye


def cameras(update: LocalizerUpdate) -> dict[Eye, Camera]:
    """Camera of each eye whose focal length is observed: of the kit, else of the sub-map.

    In models that other programs know. Those of undistorted pictures are the sub-map's: its poses
    belong to their focal lengths.
    """
    submap = update.submap
    found: dict[Eye, Camera] = {Eye.PRIMARY: submap.cameras[0]}
    if submap.assistant_ids:
        found[Eye.ASSISTANT] = submap.cameras[submap.n_primary]
    by_kit = len(found) == 2 and not any(map(lens_of, found.values()))
    sizes = picture_sizes(submap) if by_kit else None
    if sizes is not None and (theta := _kit(update, sizes)) is not None:
        found = dict(zip(Eye, layout.cameras(theta, sizes), strict=True))
    sigma = submap.focal_log_sigma
    return {
        eye: camera.standard for eye, camera in found.items() if sigma[eye] <= MAX_LOG_FOCAL_SIGMA
    }


def readout_s(update: LocalizerUpdate) -> float:
    """Readout time [s] of the primary camera's rolling shutter; 0 from a backbone without a kit."""
    theta = _kit(update)
    return 0.0 if theta is None else float(theta[layout.READOUT[0]])


def _kit(update: LocalizerUpdate, sizes: Int | None = None) -> Float | None:
    """Kit (layout.SIZE,) of an update's belief and the prior for its lenses; None without one."""
    if update.kit is None or update.kit.mean.shape != (layout.SIZE,):
        return None
    families = layout.families(update.kit.mean)
    belief = product([layout.prior((None, None), sizes, families=families), update.kit])
    assert belief is not None
    return belief.mean


def picture_sizes(submap: Submap) -> Int:
    """Width and height (2, 2) [px] of the pictures of each eye; of a sub-map with both."""
    views = submap.cameras[0], submap.cameras[submap.n_primary]
    return np.array([[view.width, view.height] for view in views], np.int64)
