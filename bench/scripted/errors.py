"""Configured errors of scripted predictions, and the random values of each batch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from calm_edge.types import Float, Hints, Int
from device.frame import Eye

# Constants of focal_factor: value in sharp turns; turn [deg] that halves the excess over it;
# divisor that makes the mean over the eleven drives of KITTI 1.
_IN_TURNS, _TURN_DEG, _MEAN = 0.3, 10.0, 0.96
# Correlation of the focal errors of both eyes: matches between them fix the ratio to about a
# percent.
_CORRELATION = 0.98


@dataclass(frozen=True, slots=True)
class ScriptedErrors:
    """Sizes of the errors of scripted predictions; lengths in world units.

    Per drive: focal_bias_log_sigma, correlated between the eyes; scale_walk, sigma of the log raw
    scale after a path of 100 world units (random walk).

    Per batch: scale_log_sigma, of the log raw units per world unit; focal_log_error, constant, one
    per eye; focal_log_sigma, correlated between the eyes; depth_drift, sigma of the change of
    log(scale of depth / scale of poses) from the first view in time to the last; bend_sigma_rad, of
    the angle by which the path is bent into an arc. The focal errors that are drawn grow on
    straight roads, see `focal_factor`.

    Per view: rotation_sigma_rad and translation_sigma of the pose; depth_warp, amplitude of a
    smooth relative depth error over the picture.

    Per observation: match_sigma_px; outlier_share, share of pixels drawn uniformly in the picture.

    coupled: poses minimise the epipolar error of exact matches under the wrong K, and depth is
    triangulated from them. If false, the focal error changes neither poses nor depth.
    false_loop_matches: a loop keyframe of another place has matches that fit its false pose.
    """

    scale_log_sigma: float = 0.0
    scale_walk: float = 0.0
    focal_log_error: tuple[float, float] = (0.0, 0.0)
    focal_bias_log_sigma: float = 0.0
    focal_log_sigma: float = 0.0
    rotation_sigma_rad: float = 0.0
    translation_sigma: float = 0.0
    bend_sigma_rad: float = 0.0
    depth_warp: float = 0.0
    depth_drift: float = 0.0
    match_sigma_px: float = 0.0
    outlier_share: float = 0.0
    coupled: bool = False
    false_loop_matches: bool = True
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Draw:
    """Random values of one batch of N views.

    scale: raw units per world unit. focal: (N,) log errors. twists: (N, 6) errors of the poses in
    se(3), world units and rad. bend: (N,) rad about the y axis of the first view. phases: (N, 3)
    rad, of the wave of depth_warp. depth: (N,) log errors of depth relative to poses.
    """

    scale: float
    focal: Float
    twists: Float
    bend: Float
    phases: Float
    depth: Float
    rng: np.random.Generator


class Errors:
    """Random errors of one drive.

    Errors constant over the drive are drawn once, the others for each batch.
    """

    def __init__(self, dials: ScriptedErrors, t_ns: Int, T_w_p: Float) -> None:
        self.dials = dials
        rng = np.random.default_rng([dials.seed, len(t_ns)])
        self._bias = dials.focal_bias_log_sigma * _alike(rng)
        steps = np.linalg.norm(np.diff(T_w_p[:, :3, 3], axis=0), axis=1)
        walk = np.cumsum(rng.standard_normal(len(steps)) * np.sqrt(steps / 100.0))
        self._t_ns = t_ns
        self._walk = dials.scale_walk * np.concatenate([[0.0], walk])

    def draw(self, hints: Hints, T_w_c: Float) -> Draw:
        """Draw the errors of views T_w_c (N, 4, 4), seeded by the stamps and hence repeatable."""
        dials, n, eyes = self.dials, len(hints.t_ns), hints.eyes
        stamps = [int(t) % (1 << 64) for t in hints.t_ns]
        rng = np.random.default_rng([dials.seed, *stamps, *(int(e) for e in eyes)])
        scale = dials.scale_log_sigma * rng.standard_normal()
        scale += np.interp(
            float(hints.t_ns[0] - self._t_ns[0]), self._t_ns - self._t_ns[0], self._walk
        )
        sigma = np.repeat([dials.translation_sigma, dials.rotation_sigma_rad], 3)
        twists = rng.standard_normal((n, 6)) * sigma
        phases = rng.uniform(0, 2 * np.pi, (n, 3))
        guess = self._bias + dials.focal_log_sigma * _alike(rng)
        focal = dials.focal_log_error + guess * focal_factor(T_w_c[eyes == Eye.PRIMARY])
        progress = _progress(hints.t_ns)
        return Draw(
            scale=float(np.exp(scale)),
            focal=focal[eyes],
            twists=twists,
            bend=dials.bend_sigma_rad * rng.standard_normal() * progress,
            phases=phases,
            depth=dials.depth_drift * rng.standard_normal() * (progress - 0.5),
            rng=rng,
        )


def focal_factor(T_w_p: Float) -> float:
    """Size of the focal error on poses (N, 4, 4) of a batch, relative to the mean on KITTI.

    A focal length is observable only in turns: the factor is 1.35 on a straight road and 0.5 in a
    turn of 40 degrees. An assumption, not measured on a model.
    """
    turns = se3.so3_log(np.swapaxes(T_w_p[:-1, :3, :3], 1, 2) @ T_w_p[1:, :3, :3])
    degrees = float(np.degrees(np.linalg.norm(turns.sum(0))))
    return (_IN_TURNS + 1 / (1 + degrees / _TURN_DEG)) / _MEAN


def _alike(rng: np.random.Generator) -> Float:
    """Draw standard normal variables (2,), one per eye, with correlation _CORRELATION."""
    common, *own = rng.standard_normal(3)
    apart = np.sqrt(1 - _CORRELATION) * np.array(own)
    return np.asarray(np.sqrt(_CORRELATION) * common + apart)


def _progress(t_ns: Int) -> Float:
    """Time (N,) as a fraction: 0 at the first view, 1 at the last, clipped for a loop keyframe."""
    span = max(int(t_ns.max() - t_ns[0]), 1)
    return np.asarray(np.clip((t_ns - t_ns[0]) / span, 0.0, 1.0))
