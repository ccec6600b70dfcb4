"""Scale sub-maps by the constant camera spacing, and place them in the world (paper IV-B).

The map unit is the spacing itself; the paper's is that of the first sub-map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import CalmEdgeError, Float, Int, Submap


class ScaleError(CalmEdgeError):
    """The scale of a sub-map cannot be determined from its two cameras."""


def resampled(t_ns: Int, T: Float, query_ns: Int) -> tuple[Float, Int]:
    """Interpolate poses of one camera at stamps of the other, on SE(3) (IV-B).

    t_ns (N,) increasing, T (N, 4, 4), query_ns (M,) -> poses (V, 4, 4) and the indices (V,) of
    their stamps in query_ns. Queries more than one frame gap before the first or after the last
    of t_ns are left out; if N is 1, all queries other than t_ns. Raises ScaleError if t_ns does
    not increase.
    """
    if np.any(np.diff(t_ns) <= 0):
        raise ScaleError("two keyframes of one camera share a stamp; check the camera's clock")
    # relative to the first frame: float64 cannot hold absolute nanoseconds exactly
    t = (t_ns - t_ns[0]).astype(np.float64)
    query = (query_ns - t_ns[0]).astype(np.float64)
    if len(t) == 1:
        (valid,) = np.nonzero(query == 0)
        return np.repeat(T, len(valid), axis=0), valid
    before, after = t[1] - t[0], t[-1] - t[-2]
    (valid,) = np.nonzero((query >= -before) & (query <= t[-1] + after))
    return se3.interpolate_at(t, T, query[valid]), valid


def rig_samples(t_p_ns: Int, T_s_p: Float, t_a_ns: Int, T_s_a: Float) -> Float:
    """Measure the rig T_p_a (V, 4, 4) at the stamp of each assistant view; raises ScaleError.

    T_s_p (N, 4, 4), T_s_a (M, 4, 4): primary and assistant camera->sub-map, any unit. Assistant
    views outside the time of the primary ones are left out, as in `resampled`.
    """
    if np.any(np.diff(t_a_ns) <= 0):
        raise ScaleError("two assistant keyframes share a stamp; check the camera's clock")
    if len(t_p_ns) and len(t_a_ns):
        T_s_ref, valid = resampled(t_p_ns, T_s_p, t_a_ns)
        if len(valid):
            return np.asarray(se3.inverse(T_s_ref) @ T_s_a[valid])
    raise ScaleError("no assistant frame was taken during the primary frames; check both clocks")


def spacing(T_p_a: Float) -> float:
    """Mean distance between the optical centres, d_k of IV-B, over rig samples (V, 4, 4)."""
    return float(np.linalg.norm(T_p_a[:, :3, 3], axis=-1).mean())


def factor(spacing_raw: float, spacing_world: float) -> float:
    """Scale of a sub-map, world units per raw unit (s_k of IV-B); raises ScaleError.

    spacing_raw, spacing_world: distance between the cameras in raw and in world units.
    """
    if not np.isfinite(spacing_raw) or spacing_raw <= 0:
        raise ScaleError("both cameras were solved to the same place: the scale is undetermined")
    return spacing_world / spacing_raw


def rectified(T: Float, scale: float) -> Float:
    """Multiply the translations of poses (..., 4, 4) by `scale`."""
    out = np.array(T, np.float64)
    out[..., :3, 3] *= scale
    return out


def rectify(submap: Submap, spacing_world: float) -> Submap:
    """Convert a sub-map from raw (scale 1) to world units by its spacing; raises ScaleError."""
    world_units = factor(spacing(_samples(submap)), spacing_world)
    return replace(submap, scale=world_units, T_s_c=rectified(submap.T_s_c, world_units))


def scatter(submap: Submap) -> float:
    """Sigma of the log scale of a sub-map from the scatter of its rig samples; inf for one sample.

    For backbones that report no sigma. It holds only if their errors differ from view to view: an
    error that all views share does not scatter.
    """
    length = np.linalg.norm(_samples(submap)[:, :3, 3], axis=-1)
    if len(length) < 2:
        return float(np.inf)
    return float(length.std(ddof=1) / length.mean() / np.sqrt(len(length)))


def _samples(submap: Submap) -> Float:
    """Rig samples (V, 4, 4) of a sub-map; raises ScaleError."""
    n, m = submap.n_primary, len(submap.assistant_ids)
    t_ns, T = submap.exposed_ns, submap.T_s_c
    return rig_samples(t_ns[:n], T[:n], t_ns[n : n + m], T[n : n + m])


def placement(T_w_f: Float, T_s_f: Float, average: bool = False) -> Float:
    """Place a sub-map by common frames: T_w_s (..., 4, 4) = T_w_f (T_s_f)^-1 (IV-B).

    T_w_f, T_s_f: (..., F, 4, 4) poses of the frames in the world and in the rectified sub-map.
    average: mean on SE(3) of the placements by each of the F frames; if False, by the first frame
    alone as in the paper.
    """
    T_w_s = T_w_f @ se3.inverse(T_s_f)
    return se3.mean(T_w_s) if average else np.asarray(T_w_s[..., 0, :, :])
