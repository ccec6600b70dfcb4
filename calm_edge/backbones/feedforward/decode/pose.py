"""Decode poses to rigid transforms camera -> first view."""

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

# largest deviation of a singular value from 1: allows float16 and quantisation, not a scale
MAX_NOT_A_ROTATION = 0.2
# second over first singular value below which the nearest rotation is not unique
MIN_STRETCH = 1e-6


def poses(spec: PoseOutput, raw: NDArray[Any], views: int) -> Float:
    """Decode T_s_c (N, 4, 4), camera -> camera of the first view, unit of the network.

    Raises BackboneError for a pose that is not finite or not a rotation.
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
        raise BackboneError("a pose of the network is not finite or has a quaternion of zero")
    rotation = Rotation.from_quat(quaternion, scalar_first=order == "wxyz")
    return se3.compose(rotation.as_matrix(), values[:, :3])


def _of_matrices(values: Float, nearest: bool) -> Float:
    """Rigid transforms (N, 4, 4) from matrices (N, 3 or 4, 4). Raises BackboneError.

    nearest: project to the nearest rotation, flipping the smallest singular direction of a
    reflection (Kabsch, 1976); otherwise a matrix that is no rotation is an error.
    """
    if not np.isfinite(values).all():
        raise BackboneError("a pose of the network is not finite")
    U, stretch, Vt = np.linalg.svd(values[:, :3, :3])
    if nearest:
        if (stretch[:, 1] < MIN_STRETCH * stretch[:, 0]).any():
            raise BackboneError("a pose matrix of the network has no unique nearest rotation")
        U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
        return se3.compose(U @ Vt, values[:, :3, 3])
    R = U @ Vt
    if (np.linalg.det(R) < 0).any() or np.abs(stretch - 1).max() > MAX_NOT_A_ROTATION:
        raise BackboneError("a pose matrix of the network is no rotation")
    return se3.compose(R, values[:, :3, 3])
