"""One scale for every sub-map from the constant camera spacing, and its place (paper IV-B).

The paper makes the first sub-map's spacing the unit; here the spacing itself is: 1 map unit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import CalmEdgeError, Float, Int, Submap


class ScaleError(CalmEdgeError):
    """The two cameras of a sub-map say nothing of its scale."""


def resampled(t_ns: Int, T: Float, query_ns: Int) -> tuple[Float, Int]:
    """Poses of one camera at another's stamps, by SE(3) interpolation (IV-B).

    t_ns (N,) increasing, T (N, 4, 4), query_ns (M,) -> poses (V, 4, 4) and the indices (V,) of
    the stamps they belong to. A matched stamp gives back its own pose, so synchronous streams
    are no special case. Stamps outside the span of t_ns by more than the frame gap at that end
    are left out; so is every unmatched one when N is 1. Raises ScaleError unless t_ns grows.
    """
    if np.any(np.diff(t_ns) <= 0):
        raise ScaleError("two keyframes of one camera share a stamp; check the camera's clock")
    # nanoseconds since the first frame: float64 holds these exactly, not a clock's full count
    t = (t_ns - t_ns[0]).astype(np.float64)
    query = (query_ns - t_ns[0]).astype(np.float64)
    if len(t) == 1:
        (valid,) = np.nonzero(query == 0)
        return np.repeat(T, len(valid), axis=0), valid
    before, after = t[1] - t[0], t[-1] - t[-2]
    (valid,) = np.nonzero((query >= -before) & (query <= t[-1] + after))
    return se3.interpolate_at(t, T, query[valid]), valid


def rig_samples(t_p_ns: Int, T_s_p: Float, t_a_ns: Int, T_s_a: Float) -> Float:
    """T_p_a (V, 4, 4) of every assistant view against the primary at its stamp; raises ScaleError.

    T_s_p (N, 4, 4), T_s_a (M, 4, 4): primary and assistant camera->sub-map, any unit.
    """
    if np.any(np.diff(t_a_ns) <= 0):
        raise ScaleError("two assistant keyframes share a stamp; check the camera's clock")
    if len(t_p_ns) and len(t_a_ns):
        T_s_ref, valid = resampled(t_p_ns, T_s_p, t_a_ns)
        if len(valid):
            return np.asarray(se3.inverse(T_s_ref) @ T_s_a[valid])
    raise ScaleError("no assistant frame was taken during the primary frames; check both clocks")


def spacing(T_p_a: Float) -> float:
    """The mean distance of the optical centres, d_k of IV-B, of samples (V, 4, 4), their unit."""
    return float(np.linalg.norm(T_p_a[:, :3, 3], axis=-1).mean())


def factor(spacing_raw: float, spacing_world: float) -> float:
    """World units a raw unit, s_k of IV-B; raises ScaleError.

    The spacing in raw and in world units (`ScaleConfig.spacing`).
    """
    if not np.isfinite(spacing_raw) or spacing_raw <= 0:
        raise ScaleError("the two cameras were solved into one place: no scale in this sub-map")
    return spacing_world / spacing_raw


def rectified(T: Float, scale: float) -> Float:
    """Poses (..., 4, 4) with their translations multiplied by `scale`."""
    out = np.array(T, np.float64)
    out[..., :3, 3] *= scale
    return out


def rectify(submap: Submap, spacing_world: float) -> Submap:
    """A sub-map in raw units (scale 1) brought to world units by its spacing; raises ScaleError.

    spacing_world: `ScaleConfig.spacing`.
    """
    n, m = submap.n_primary, len(submap.assistant_ids)
    t_ns, T = submap.exposed_ns, submap.T_s_c
    T_p_a_raw = rig_samples(t_ns[:n], T[:n], t_ns[n : n + m], T[n : n + m])
    world_units = factor(spacing(T_p_a_raw), spacing_world)
    return replace(submap, scale=world_units, T_s_c=rectified(T, world_units))


def placement(T_w_f: Float, T_s_f: Float, average: bool = False) -> Float:
    """T_w_s (..., 4, 4) of a sub-map from its common frames: T_w_s = T_w_f (T_s_f)^-1 (IV-B).

    T_w_f, T_s_f: (..., F, 4, 4), the frames in the world and in the rectified sub-map. The paper
    uses the first frame; `average` takes the mean over all of them on the manifold.
    """
    T_w_s = T_w_f @ se3.inverse(T_s_f)
    return se3.mean(T_w_s) if average else np.asarray(T_w_s[..., 0, :, :])
