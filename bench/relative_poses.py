"""Errors of relative poses over stretches of a drive, with the sigmas that the product claims.

A stretch begins where the one before ends, so that the errors of different ones are independent
but for what is common to the drive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from bench.graph_covariance import optimised
from calm_edge.config import Config
from calm_edge.evaluation.live import parts
from calm_edge.evaluation.motion_covariance import motion_covariance
from calm_edge.evaluation.trajectory import associate
from calm_edge.evaluation.truth import Truth
from calm_edge.geometry import se3
from calm_edge.offline.drive import Drive
from calm_edge.types import Float, Int, PoseSample

SPAN_S = 1.0
DISTANCE_M = 100.0
# A stretch longer than its nominal length by more than this factor is not used: poses are missing.
LONGEST = 1.25
# Share of the focal by which derivatives are taken.
_SHARE = 1e-4


@dataclass(frozen=True, slots=True)
class Stretches:
    """Errors of the relative poses over B stretches.

    error, sigma: (B, 6) of (translation, rotation), metres and rad, axes of the later pose. sigma
    is NaN where none is claimed. length_m: (B,) true distance between the ends.
    """

    error: Float
    sigma: Float
    length_m: Float

    @classmethod
    def none(cls) -> Stretches:
        return cls(np.zeros((0, 6)), np.zeros((0, 6)), np.zeros(0))

    @classmethod
    def of_json(cls, value: dict[str, Any]) -> Stretches:
        n = len(value["length_m"])
        table = {key: np.array(value[key], np.float64) for key in cls.__slots__}
        return cls(table["error"].reshape(n, 6), table["sigma"].reshape(n, 6), table["length_m"])

    def to_json(self) -> dict[str, Any]:
        return {key: getattr(self, key).tolist() for key in self.__slots__}


def ends(along: Float, length: float, part: Int) -> tuple[Int, Int]:
    """First and last index (B,), (B,) of consecutive stretches of at least `length`.

    along: (N,) time or distance, ascending. part: (N,) number of the part a pose belongs to; no
    stretch crosses from one part to another, nor a gap that makes it LONGEST times too long.
    """
    first, last = [], []
    i = 0
    while i < len(along):
        j = int(np.searchsorted(along, along[i] + length * (1 - 1e-6)))
        if j >= len(along):
            break
        inside = part[j] == part[i] and along[j] - along[i] <= LONGEST * length
        if inside:
            first.append(i)
            last.append(j)
        i = j if inside else i + 1
    return np.array(first, np.int64), np.array(last, np.int64)


def errors(T: Float, T_truth: Float, i: Int, j: Int) -> Float:
    """Twists (B, 6) from the true to the estimated motion from poses i to poses j."""
    moved = se3.inverse(T[i]) @ T[j]
    true = se3.inverse(T_truth[i]) @ T_truth[j]
    return np.asarray(se3.log(se3.inverse(true) @ moved))


def along_track(t_ns: Int, T_truth: Float) -> dict[str, tuple[Float, float]]:
    """What stretches are measured along: time [s] and true path [m], each with its length."""
    steps = np.linalg.norm(np.diff(T_truth[:, :3, 3], axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    return {"1 s": ((t_ns - t_ns[0]) / 1e9, SPAN_S), "100 m": (path, DISTANCE_M)}


def of_live(
    samples: Sequence[PoseSample], truth: Truth, with_scale: bool = True
) -> dict[str, Stretches]:
    """Stretches of the poses as published, with the covariances published with them.

    with_scale: whether the version knows of the scale's error; if not, the covariances of its poses
    are all it claims.
    """
    usable = np.array([s.status.usable for s in samples], np.bool_)
    live = [s for s in samples if s.status.usable]
    a, b = associate(np.array([s.t_ns for s in live], np.int64), truth.t_ns)
    if not len(a):
        return {}
    live = [live[k] for k in a]
    T = np.stack([sample.T_w_c for sample in live])
    part = parts(samples)[usable][a]
    t_ns, T_truth = truth.t_ns[b], truth.T_w_c[b]
    out = {}
    for name, (along, length) in along_track(t_ns, T_truth).items():
        i, j = ends(along, length, part)
        pairs = zip(i.tolist(), j.tolist(), strict=True)
        total = [motion_covariance(live[first], live[then], with_scale) for first, then in pairs]
        out[name] = _stretches(T, T_truth, i, j, np.array(total).reshape(-1, 6, 6))
    return out


def _of_scale(T: Float, i: Int, j: Int, sigma: Float) -> Float:
    """Covariances (B, 3, 3) of the way from poses i to poses j, of a log scale with sigma (B,).

    NaN where sigma is not finite.
    """
    moved = (se3.inverse(T[j]) @ T[i])[:, :3, 3]
    known = np.where(np.isfinite(sigma), sigma, np.nan)
    return np.asarray(known[:, None, None] ** 2 * moved[:, :, None] * moved[:, None])


class Common(NamedTuple):
    """Sigmas of the errors that a whole drive has in common, of which its graph does not know.

    scale, focal: of the log scale and of the primary's log focal; None or inf if unknown. axes:
    (2,) of its axes about x and y [rad], by its principal point; None if not reported.
    """

    scale: float | None
    focal: float | None
    axes: tuple[float, float] | None = None


def of_final(drive: Drive, config: Config, truth: Truth, common: Common) -> dict[str, Stretches]:
    """Stretches of the final trajectory, with the covariances of the joint graph and `common`.

    Without a sigma of the scale those of translations are NaN, without one of the focal all are.
    """
    loops = [update.loop for update in drive.updates if update.loop is not None]
    found = optimised([update.submap for update in drive.updates], config, loops)
    if found is None:
        return {}
    trajectory, marginals = found
    a, b = associate(trajectory.t_ns, truth.t_ns)
    if not len(a):
        return {}
    T, t_ns, T_truth = trajectory.T_w_c[a], truth.t_ns[b], truth.T_w_c[b]
    out = {}
    for name, (along, length) in along_track(t_ns, T_truth).items():
        i, j = ends(along, length, np.zeros(len(along), np.int64))
        total = np.zeros((len(i), 6, 6))
        for k, (origin, end) in enumerate(zip(a[i].tolist(), a[j].tolist(), strict=True)):
            total[k] = marginals.covariances(np.array([end]), origin)[0]
        scale, focal = (np.nan if s is None else s for s in (common.scale, common.focal))
        total[:, :3, :3] += _of_scale(T, i, j, np.full(len(i), scale))
        effect = focal_effect(T, i, j)
        total += (focal**2 if np.isfinite(focal) else np.nan) * effect[:, :, None] * effect[:, None]
        by_axes = axes_effect(T, i, j) * np.array(common.axes or (0.0, 0.0))
        total += by_axes @ np.swapaxes(by_axes, 1, 2)
        out[name] = _stretches(T, T_truth, i, j, total)
    return out


def focal_effect(T: Float, i: Int, j: Int) -> Float:
    """Derivatives (B, 6) of the motions from poses i to poses j by the log focal.

    A focal that is too long makes turns too small: those about x and y, which move the picture
    sideways, by the same share. T: (N, 4, 4).
    """
    steps = se3.inverse(T[:-1]) @ T[1:]
    turn = se3.so3_log(steps[:, :3, :3])
    turn[:, :2] *= 1 - _SHARE
    turned = se3.compose(se3.so3_exp(turn), steps[:, :3, 3])
    out = np.zeros((len(i), 6))
    for k, (first, last) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
        moved = [np.eye(4), np.eye(4)]
        for step in range(first, last):
            moved = [moved[0] @ steps[step], moved[1] @ turned[step]]
        out[k] = se3.log(se3.inverse(moved[0]) @ moved[1]) / _SHARE
    return out


def axes_effect(T: Float, i: Int, j: Int) -> Float:
    """Derivatives (B, 6, 2) of the motions from poses i to poses j by turns of all axes about x, y.

    A principal point that is off turns the axes of a camera by the same angle at all times, and the
    car then seems to move aside. T: (N, 4, 4).
    """
    back = se3.inverse(T[j]) @ T[i]
    return np.asarray((np.eye(6) - se3.adjoint(back))[:, :, 3:5])


def _stretches(T: Float, T_truth: Float, i: Int, j: Int, covariance: Float) -> Stretches:
    length = np.linalg.norm(T_truth[j, :3, 3] - T_truth[i, :3, 3], axis=-1)
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    return Stretches(errors(T, T_truth, i, j), np.sqrt(variance), length)
