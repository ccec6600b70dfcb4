"""Sub-maps with given focals, and landmarks of both cameras in one batch."""

from __future__ import annotations

import numpy as np

from bench.scripted.motions import CAMERA, N_VIEWS
from calm_edge.types import Landmarks, Submap


def submap(number: int, focals: tuple[float, float], n: int = N_VIEWS) -> Submap:
    """A sub-map of n views per camera with the given focals [px] and arbitrary poses.

    It ends with a loop keyframe of a wrong focal.
    """
    guesses = np.repeat([*focals, 1e5], [n, n, 1]).tolist()
    cameras = tuple(CAMERA.with_focal(focal) for focal in guesses)
    poses = np.tile(np.eye(4), (2 * n + 1, 1, 1))
    ids = tuple(range(number * n, (number + 1) * n))
    return Submap(
        id=number,
        primary_ids=ids,
        assistant_ids=ids,
        n_overlap=0,
        t_ns=np.arange(2 * n + 1),
        T_s_c_raw=poses,
        cameras_raw=cameras,
        T_s_c=poses,
        cameras=cameras,
        scale=1.0,
        T_w_s=np.eye(4),
        focal_log_sigma=np.full(2, np.inf),
    )


def both_eyes(landmarks: Landmarks, other: Landmarks, n: int = N_VIEWS) -> Landmarks:
    """Landmarks of primary and assistant in one batch."""
    return Landmarks(
        points_s=np.concatenate([landmarks.points_s, other.points_s]),
        index=np.concatenate([landmarks.index, other.index + len(landmarks.points_s)]),
        view=np.concatenate([landmarks.view, other.view + n]),
        uv=np.concatenate([landmarks.uv, other.uv]),
    )
