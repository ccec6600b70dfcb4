"""What the tracker keeps from one frame to the next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from calm_edge.geometry.camera import Camera
from calm_edge.types import Bytes, Float, Float32

# Frames are kept so that a sub-map that comes late can be followed from its keyframes to now.
REMEMBERED_NS, MOST_REMEMBERED = 12_000_000_000, 360


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
    """Points followed: p_m (M, 3) map frame, uv (M, 2) px in the image `seen_in`."""

    camera: Camera
    p_m: Float
    uv: Float32
    seen_in: Bytes


def spaced(t_ns: Sequence[int], since_ns: int, gap_ns: int) -> list[int]:
    """Which of the times after since_ns lie gap_ns or more behind one another; the last always.

    A camera of three times the rate shows no more by showing it oftener.
    """
    chosen, before = [], since_ns
    for i, t in enumerate(t_ns):
        if t - before >= gap_ns or (i == len(t_ns) - 1 and t > before):
            chosen.append(i)
            before = t
    return chosen
