"""Correct a sub-map's poses and intrinsics to K_global (paper V-C).

The paper's rotation correction is for two views and the baseline between them. For the rotation
between the two cameras the direction of travel is used as baseline instead: in a window of many
views, depth and thus this rotation are determined by the motion of the car, not by the sideways
baseline of the cameras. With a focal too long by a factor s the angle between the cameras is too
small by s, where two views alone would make it too large; correcting with the sideways baseline
doubles the error (tests/correction).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction import pose_model
from calm_edge.geometry import se3
from calm_edge.types import Float, GlobalIntrinsics, Int, Submap
from device.frame import Eye

# minimum number of assistant views for estimating a trend
_LEAST_FOR_TREND = 5


def rectified(submap: Submap, intrinsics: GlobalIntrinsics, config: CorrectionConfig) -> Submap:
    """Rectify a raw sub-map with the intrinsics of the search: new T_s_c and cameras (V-C).

    submap: with raw T_s_c and cameras and scale 1; at least one primary view. T_s_c (N, 4, 4)
    stays in the raw unit, with the first pose unchanged. Focals become f / (1 + damping (s - 1));
    depth must be back-projected with these. Returns the input if both dampings are zero. `config`
    can disable the correction of rotations or translations, not that of focals.
    """
    if not np.any(intrinsics.damping):
        return submap
    n, m = submap.n_primary, len(submap.assistant_ids)
    eyes = np.full(len(submap.t_ns), Eye.PRIMARY)
    eyes[n : n + m] = Eye.ASSISTANT
    S = np.stack(
        [
            pose_model.damped_scaling(camera, intrinsics.cameras[eye], intrinsics.damping[eye])
            for camera, eye in zip(submap.cameras, eyes, strict=True)
        ]
    )
    cameras = tuple(map(pose_model.effective_camera, submap.cameras, S))
    T, S_p = submap.T_s_c, S[:n].mean(0)
    primary = _primary(T[:n], S[:n], config)
    exposed = submap.exposed_ns
    between = _bracketed(exposed[:n], exposed[n : n + m])
    joint = (S_p + S[n : n + m]) / 2
    assistant = _assistant(T[:n], primary, T[n : n + m], between, joint, config)
    loop = _loop(T[:n], primary, T[n + m :], S_p, config)
    return replace(submap, T_s_c=np.concatenate([primary, assistant, loop]), cameras=cameras)


def _corrected(
    T_a_b: Float, S: Float, config: CorrectionConfig, along: Float | None = None
) -> Float:
    """Apply the enabled parts of the correction by S (..., 3, 3) to relative poses (N, 4, 4).

    along: (N, 3) baseline for the rotation, in axes of a; None: the translation of the pose.
    """
    R, t = T_a_b[..., :3, :3], T_a_b[..., :3, 3]
    baseline = t if along is None else along
    new_R = pose_model.corrected_rotation(baseline, R, S) if config.rotation else R
    if not config.translation:
        return se3.compose(new_R, t)
    if config.general_translation:
        return se3.compose(new_R, pose_model.translation_general(t, R, S))
    return se3.compose(new_R, pose_model.translation_simple(t, S))


def _primary(T_s_p: Float, S: Float, config: CorrectionConfig) -> Float:
    """Primary poses (N, 4, 4), chained from the corrected relative poses (V-C).

    A relative pose is corrected by the mean S of its two views, as V-C does between the cameras.
    """
    steps = _corrected(se3.inverse(T_s_p[:-1]) @ T_s_p[1:], (S[:-1] + S[1:]) / 2, config)
    chain = [T_s_p[0]]
    for step in steps:
        chain.append(chain[-1] @ step)
    return np.stack(chain)


class _Between(NamedTuple):
    """Primary views before and after each assistant stamp (M,), and its position between them.

    share: 0 at `before`, 1 at `after`; in [-1, 2] for stamps up to one frame interval outside.
    """

    before: Int
    after: Int
    share: Float


def _bracketed(t_p_ns: Int, t_a_ns: Int) -> _Between:
    """Locate the assistant's stamps (M,) among the primary's (N,).

    A stamp further outside than one frame interval is moved to the nearest end; of views with
    equal stamps the first is used. Wrong stamps are detected later, in the scale estimation.
    """
    t_ns, first = np.unique(t_p_ns, return_index=True)
    if len(t_ns) == 1:
        nowhere = np.zeros(len(t_a_ns), np.int64)
        return _Between(nowhere, nowhere, nowhere.astype(np.float64))
    i = np.clip(np.searchsorted(t_ns, t_a_ns, side="right") - 1, 0, len(t_ns) - 2)
    share = (t_a_ns - t_ns[i]) / (t_ns[i + 1] - t_ns[i])
    share = np.where(share < -1, 0.0, np.where(share > 2, 1.0, share))
    return _Between(first[i], first[i + 1], share)


def _assistant(
    T_s_p: Float, T_s_p_new: Float, T_s_a: Float, between: _Between, S_joint: Float,
    config: CorrectionConfig,
) -> Float:  # fmt: skip
    """Rectified assistant poses (M, 4, 4), relative to the primary interpolated at their stamps.

    T_s_p, T_s_p_new: primary before and after rectification. S_joint: focal ratios, the mean of
    both cameras.
    """
    before, after, share = between
    both = np.stack([T_s_p, T_s_p_new])
    T_s_ref, T_s_ref_new = se3.interpolate(both[:, before], both[:, after], share)
    T_ref_s = se3.inverse(T_s_ref)
    travel = T_s_p[after, :3, 3] - T_s_p[before, :3, 3]
    along = (T_ref_s[:, :3, :3] @ travel[..., None])[..., 0]
    T_p_a = _corrected(T_ref_s @ T_s_a, S_joint, config, along)
    if config.rigid_rig:
        T_p_a = without_trend(T_p_a, (before + share)[:, None])
    return np.asarray(T_s_ref_new @ T_p_a)


def without_trend(T_p_a: Float, t: Float) -> Float:
    """Remove the linear trend from rig transforms (M, 4, 4) at times t (M, 1), in any unit.

    The rig is rigid, so a constant rate of the assistant relative to the primary is a residual
    effect of its focal error. The joint graph would distribute it over the motion of both cameras.
    """
    if len(T_p_a) < _LEAST_FOR_TREND or np.ptp(t) == 0:
        return T_p_a
    middle = se3.mean(T_p_a)
    off = se3.log(se3.inverse(middle) @ T_p_a)
    since = t - t.mean()
    slope = (since * off).sum(0) / (since**2).sum()
    return np.asarray(middle @ se3.exp(off - since * slope))


def _loop(
    T_s_p: Float, T_s_p_new: Float, T_s_l: Float, S: Float, config: CorrectionConfig
) -> Float:
    """Rectified loop views (L, 4, 4).

    The pose of each relative to the primary view nearest in position is corrected by the focal
    ratios S (3, 3) and applied to that view's rectified pose.
    """
    apart = np.linalg.norm(T_s_l[:, None, :3, 3] - T_s_p[None, :, :3, 3], axis=-1)
    nearest = apart.argmin(1)
    T_ref_l = se3.inverse(T_s_p[nearest]) @ T_s_l
    return np.asarray(T_s_p_new[nearest] @ _corrected(T_ref_l, S, config))
