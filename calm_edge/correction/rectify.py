"""A sub-map's poses and intrinsics under K_global instead of the backbone's own (paper V-C).

The paper's rotation error is that of two views alone, where the epipolar constraint acts across
the baseline. Between the eyes that baseline is sideways; but a whole window fixes the depth of its
points along the path of travel, and with it the rig's rotation: a focal s times too long shrinks a
toe-in by s there, where two views alone would widen it. So the rig's rotation is corrected along
the travel; along the baseline, as the paper has it, the error doubles (tests/correction).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.config import CorrectionConfig
from calm_edge.correction import pose_model
from calm_edge.geometry import se3
from calm_edge.types import Float, GlobalIntrinsics, Int, Submap
from device.frame import Eye


def rectified(
    submap: Submap,
    intrinsics: GlobalIntrinsics,
    config: CorrectionConfig,
    *,
    rig_by_travel: bool = True,
) -> Submap:
    """The raw sub-map with T_s_c and K as the search's intrinsics have them (V-C).

    submap: as the backbone gave it: scale 1, T_s_c and K its raw ones; it needs a primary view.
    T_s_c (N, 4, 4) stays in the raw unit and starts where it did; K (N, 3, 3) becomes
    f_est / (1 + damping (s - 1)) an axis, so depth is to be back-projected with it. With zero
    damping all of it comes back as it was. `config` may switch off either half of the poses'
    correction; K is corrected all the same. rig_by_travel: off, the rotation between the eyes is
    corrected along their baseline, right where a backbone looks at pairs of views alone.
    """
    n, m = submap.n_primary, len(submap.assistant_ids)
    eyes = np.full(len(submap.t_ns), Eye.PRIMARY)
    eyes[n : n + m] = Eye.ASSISTANT
    if not np.any(intrinsics.damping):
        return submap
    S = pose_model.damped_scaling(submap.K, intrinsics.K[eyes], intrinsics.damping[eyes])
    K = pose_model.effective_intrinsics(submap.K, S)
    t_ns, T, eye_S = submap.t_ns, submap.T_s_c, S[:n].mean(0)
    primary = _primary(T[:n], S[:n], config)
    S_joint = (eye_S + S[n : n + m]) / 2
    T_s_ref, T_s_ref_new = (_at(t_ns[:n], P, t_ns[n : n + m]) for P in (T[:n], primary))
    T_ref_a = se3.inverse(T_s_ref) @ T[n : n + m]
    along = _travel(t_ns[:n], T[:n], t_ns[n : n + m], T_s_ref) if rig_by_travel else None
    assistant = T_s_ref_new @ _corrected(T_ref_a, S_joint, config, along)
    loop = _loop(T[:n], primary, T[n + m :], eye_S, config)
    return replace(submap, T_s_c=np.concatenate([primary, assistant, loop]), K=K)


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


def _at(t_ns: Int, T: Float, query_ns: Int) -> Float:
    """The trajectory t_ns (N,), T (N, 4, 4) at stamps (M,), (M, 4, 4).

    Its nearest end where a stamp lies more than the frame gap there outside, and the first of
    views that share a stamp: whether such stamps mean anything is for the scale to say.
    """
    t_ns, first = np.unique(t_ns, return_index=True)
    T = T[first]
    if len(t_ns) == 1:
        return np.repeat(T, len(query_ns), axis=0)
    t = (t_ns - t_ns[0]).astype(np.float64)
    query = (query_ns - t_ns[0]).astype(np.float64)
    query = np.where(query < t[0] - t[1], 0.0, query)
    query = np.where(query > 2 * t[-1] - t[-2], t[-1], query)
    return se3.interpolate_at(t, T, query)


def _travel(t_ns: Int, T_s_p: Float, query_ns: Int, T_s_ref: Float) -> Float:
    """(M, 3) the step during which each stamp fell, in the axes of its reference; 0 of one view."""
    if len(t_ns) == 1:
        return np.zeros((len(query_ns), 3))
    steps = np.diff(T_s_p[:, :3, 3], axis=0)
    i = np.clip(np.searchsorted(t_ns, query_ns, side="right") - 1, 0, len(steps) - 1)
    return np.asarray((np.swapaxes(T_s_ref[:, :3, :3], -1, -2) @ steps[i, :, None])[..., 0])


def _loop(
    T_s_p: Float, T_s_p_new: Float, T_s_l: Float, S: Float, config: CorrectionConfig
) -> Float:
    """Loop views (L, 4, 4) relative to the primary view whose raw centre is nearest."""
    apart = np.linalg.norm(T_s_l[:, None, :3, 3] - T_s_p[None, :, :3, 3], axis=-1)
    nearest = apart.argmin(1)
    T_ref_l = se3.inverse(T_s_p[nearest]) @ T_s_l
    return np.asarray(T_s_p_new[nearest] @ _corrected(T_ref_l, S, config))
