"""Poses of any encoding -> camera->first view."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.feedforward.decode.arrays import of_views
from calm_edge.backbones.onnx.manifest import PoseOutput
from calm_edge.geometry import se3
from calm_edge.types import Float

# what float16 and quantised weights leave of orthogonality; a mirror or a scale is farther off
MAX_NOT_A_ROTATION = 0.2
# a matrix of rank one has no nearest rotation: it leaves a turn about its axis open
MIN_STRETCH = 1e-6


def poses(spec: PoseOutput, raw: NDArray[Any], views: int) -> Float:
    """(N, 4, 4) camera->first view's camera, rigid, the unit of the network.

    Raises BackboneError where a pose is not finite or no rotation.
    """
    if spec.encoding == "t_quatxyzw_fovhw":
        T = _of_quaternions(of_views(spec.name, raw, views, (9,)), "xyzw")
    elif spec.encoding == "t_quat":
        T = _of_quaternions(of_views(spec.name, raw, views, (7,)), spec.quaternion)
    else:
        rows = 3 if spec.encoding == "mat3x4" else 4
        T = _of_matrices(of_views(spec.name, raw, views, (rows, 4)), spec.rotation == "nearest")
    T_w_c = se3.inverse(T) if spec.direction == "world_to_camera" else T
    T_s_c = se3.inverse(T_w_c[0]) @ T_w_c
    T_s_c[0] = np.eye(4)
    return np.asarray(T_s_c)


def _of_quaternions(values: Float, order: str) -> Float:
    quaternion = values[:, 3:7]
    length = np.linalg.norm(quaternion, axis=1)
    if not (np.isfinite(values[:, :7]).all() and (length > 1e-6).all()):
        raise BackboneError("the network gave a pose that is not finite, or a quaternion of zero")
    rotation = Rotation.from_quat(quaternion, scalar_first=order == "wxyz")
    return se3.compose(rotation.as_matrix(), values[:, :3])


def _of_matrices(values: Float, nearest: bool) -> Float:
    """nearest: of any matrix the rotation that is least off it, else a matrix that is none is bad.

    The least stretched axis turns around where the matrix is a mirror (Kabsch).
    """
    if not np.isfinite(values).all():
        raise BackboneError("the network gave a pose that is not finite")
    U, stretch, Vt = np.linalg.svd(values[:, :3, :3])
    if nearest:
        if (stretch[:, 1] < MIN_STRETCH * stretch[:, 0]).any():
            raise BackboneError("the network gave a pose matrix that is near to no one rotation")
        U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
        return se3.compose(U @ Vt, values[:, :3, 3])
    R = U @ Vt
    if (np.linalg.det(R) < 0).any() or np.abs(stretch - 1).max() > MAX_NOT_A_ROTATION:
        raise BackboneError("the network gave a pose whose matrix is no rotation")
    return se3.compose(R, values[:, :3, 3])
