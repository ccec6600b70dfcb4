"""Geometric consistency of the depth maps of a window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.types import Float, Float32

# A point is not compared with another view if its z-depth there is below this share of its z-depth
# in its own view.
NEAREST_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class DepthView:
    """Depth of a view: inverse depth zeta (h, w), 1/spacings, 0 at infinity.

    camera: pinhole, of a picture of w x h px. T_s_c: (4, 4) camera to sub-map, spacings.
    """

    zeta: Float32
    camera: Camera
    T_s_c: Float


@dataclass(frozen=True, slots=True)
class Agreement:
    """Consistent inverse depth of a view; each field is (h, w).

    zeta: mean of the view's own value and those of the other views that agree with it, 1/spacings.
    votes: number of those others. spread: root mean square of their differences from the view's own
    value, 1/spacings.
    """

    zeta: Float32
    votes: Float32
    spread: Float32


def agree(
    view: DepthView, others: Sequence[DepthView], relative: float, absolute: float
) -> Agreement:
    """Compare the inverse depth of every pixel with that of other views, by reprojection.

    The point of the pixel is projected into the other view, and the depth found there is
    transformed back. Inverse depths agree if they differ by less than `absolute` [1/spacings] plus
    `relative` times the inverse depth. The check of Schoenberger et al., "Pixelwise View Selection
    for Unstructured Multi-View Stereo", ECCV 2016.
    """
    h, w = view.zeta.shape
    y, x = np.mgrid[:h, :w]
    pixels = np.stack([x.ravel(), y.ravel()], -1)
    ray = view.camera.back_project(pixels, np.ones(h * w)).T.astype(np.float32)
    zeta = view.zeta.ravel()
    total, votes, squares = zeta.copy(), np.zeros_like(zeta), np.zeros_like(zeta)
    for other in others:
        T_o_v = (se3.inverse(other.T_s_c) @ view.T_s_c).astype(np.float32)
        R, t = T_o_v[:3, :3], T_o_v[:3, 3]
        q = R @ ray + t[:, None] * zeta  # in the other view's axes, times zeta: finite at infinity
        in_front = q[2] > NEAREST_SHARE
        q /= np.where(in_front, q[2], 1)
        uv = other.camera.project(np.where(in_front, q, 1).T).T
        found = cv2.remap(
            other.zeta, uv[0].reshape(h, w), uv[1].reshape(h, w), cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT, borderValue=-1,
        ).ravel()  # fmt: skip
        # the other view has a point at inverse depth `found` there: its z in this view, times
        # `found`
        back_z = R[:, 2] @ q - found * (R[:, 2] @ t)
        back = np.where(back_z > 1e-3, found / np.maximum(back_z, 1e-3), -1)
        close = in_front & (found >= 0) & (np.abs(back - zeta) < relative * zeta + absolute)
        votes += close
        total += np.where(close, back, 0)
        squares += np.where(close, (back - zeta) ** 2, 0)
    spread = np.sqrt(squares / np.maximum(votes, 1))
    shape = (h, w)
    return Agreement(
        (total / (votes + 1)).reshape(shape), votes.reshape(shape), spread.reshape(shape)
    )
