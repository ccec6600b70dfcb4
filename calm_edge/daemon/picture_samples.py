"""Frames kept from a drive, to say why there is no window."""

from __future__ import annotations

from calm_edge.frontend.diagnosis import Cause, of_frames
from device.frame import Eye, Frame


class PictureSamples:
    """Pairs of neighbouring frames of each camera: the first, second, fourth, eighth ... and next.

    So their number grows with the logarithm of the drive's length.
    """

    def __init__(self) -> None:
        self._frames: dict[Eye, list[Frame]] = {eye: [] for eye in Eye}
        self._count = dict.fromkeys(Eye, 0)

    def add(self, frame: Frame) -> None:
        """Keep a frame, if its number asks for it."""
        self._count[frame.eye] = n = self._count[frame.eye] + 1
        if n & (n - 1) == 0 or (n - 1) & (n - 2) == 0:
            self._frames[frame.eye].append(frame)

    def clear(self) -> None:
        """Drop the frames: there is a window."""
        for frames in self._frames.values():
            frames.clear()

    def causes(self) -> tuple[Cause, ...]:
        """What is wrong with the pictures; empty if nothing is found."""
        return of_frames(self._frames[Eye.PRIMARY], self._frames[Eye.ASSISTANT])
