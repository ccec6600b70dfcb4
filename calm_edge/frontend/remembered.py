"""What the tracker keeps from one frame to the next."""

from __future__ import annotations

from dataclasses import dataclass

from calm_edge.types import Bytes, Float, Float32


@dataclass(slots=True)
class Past:
    """A frame that was tracked: gray (H, W), T_m_c (4, 4) camera->map or None where it was lost.

    keyframe_id: of the keyframe it became, or None.
    """

    t_ns: int
    gray: Bytes
    keyframe_id: int | None
    T_m_c: Float | None


@dataclass(slots=True)
class Tracks:
    """Points followed: p_m (M, 3) map frame, uv (M, 2) px in the image `seen_in`. K: (3, 3) px."""

    K: Float
    p_m: Float
    uv: Float32
    seen_in: Bytes
