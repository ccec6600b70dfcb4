"""A sub-map's poses and intrinsics under K_global instead of the backbone's own (paper V-C).

The paper's rotation error is that of two views alone, where the epipolar constraint acts across
the baseline. Between the eyes that baseline is sideways; but a whole window fixes the depth of its
points along the path of travel, and with it the rig's rotation: a focal s times too long shrinks a
toe-in by s there, where two views alone would widen it. So the rig's rotation is corrected along
the travel; along the baseline, as the paper has it, the error doubles (tests/correction).
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

# assistant views from which a trend can be told from noise
_LEAST_FOR_TREND = 5


def rectified(submap: Submap, intrinsics: GlobalIntrinsics, config: CorrectionConfig) -> Submap:
    """The raw sub-map with T_s_c and cameras as the search's intrinsics have them (V-C).

    submap: as the backbone gave it: scale 1, T_s_c and cameras raw; it needs a primary view.
    T_s_c (N, 4, 4) stays in the raw unit and starts where it did; focals become
    f_est / (1 + damping (s - 1)) an axis, so depth is to be back-projected with them. With zero
    damping all of it comes back as it was. `config` may switch off either half of the poses'
    correction, not that of the focals.
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
    """Relative poses (N, 4, 4) with the switched-on halves of the correction by S (..., 3, 3).

    along: (N, 3) in a's axes, the baseline of the rotation's correction; None for the pose's own.
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
    """Chained from the first view over corrected steps, (N, 4, 4).

    A step has the mean S of its two views, the rule of S_joint.
    """
    steps = _corrected(se3.inverse(T_s_p[:-1]) @ T_s_p[1:], (S[:-1] + S[1:]) / 2, config)
    chain = [T_s_p[0]]
    for step in steps:
        chain.append(chain[-1] @ step)
    return np.stack(chain)


class _Between(NamedTuple):
    """Of each stamp (M,): the primary views before and after it, and how far it is from one to
    the other, 0 to 1; beyond where the stamp lies up to one gap outside.
    """

    before: Int
    after: Int
    share: Float


def _bracketed(t_p_ns: Int, t_a_ns: Int) -> _Between:
    """Where the assistant's stamps (M,) lie among the primary's (N,).

    At the nearest end where one lies more than the frame gap there outside; of views that share
    a stamp the first counts. Whether such stamps mean anything is for the scale to say.
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
    """Each view (M, 4, 4) relative to the primary at its stamp: raw there, rectified back."""
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
    """Rig samples (M, 4, 4) at times t (M, 1), any unit, less what of them grows evenly in time.

    The rig is rigid: a slow turn of the assistant against the primary is what its wrong focal left
    over, and the joint graph would take it for motion and share it out between the eyes. The
    primary's motion is the one that the correction is exact for.
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
    """Loop views (L, 4, 4) relative to the primary view whose raw centre is nearest."""
    apart = np.linalg.norm(T_s_l[:, None, :3, 3] - T_s_p[None, :, :3, 3], axis=-1)
    nearest = apart.argmin(1)
    T_ref_l = se3.inverse(T_s_p[nearest]) @ T_s_l
    return np.asarray(T_s_p_new[nearest] @ _corrected(T_ref_l, S, config))
