"""Frames held by the estimator process, so that each frame is sent to it only once."""

from __future__ import annotations

from collections.abc import Iterable

from calm_edge.daemon.messages import Process
from calm_edge.recording.window_record import FrameKey, WindowRecord, frame_key, rebuild
from calm_edge.types import SubmapWindow
from device.frame import Frame


def kept_frames(keys: Iterable[FrameKey], window: WindowRecord) -> set[FrameKey]:
    """Select the frames among `keys` that the estimator keeps after processing `window`.

    These are the frames of the window and newer ones. Both processes call this, so that the sender
    has the same list as the receiver.
    """
    own, newest_ns = set(window.frame_keys), window.t_ns[window.n_primary - 1]
    return {key for key in keys if key in own or key[2] > newest_ns}


class ReceivedFrames:
    """Store of the received frames, from which windows are assembled."""

    def __init__(self) -> None:
        self._frames: dict[FrameKey, Frame] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, frame: Frame) -> None:
        """Keep a received frame until no later window needs it."""
        self._frames[frame_key(frame)] = frame

    def window(self, message: Process) -> SubmapWindow:
        """Assemble the window of a message, and drop frames that no later window needs."""
        for frame in message.frames:
            self.add(frame)
        window = rebuild(message.window, lambda *key: self._frames[key])
        self._frames = {key: self._frames[key] for key in kept_frames(self._frames, message.window)}
        return window
