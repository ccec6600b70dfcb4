"""The frames that the estimator process has received, so that each is sent once."""

from __future__ import annotations

from collections.abc import Iterable

from calm_edge.daemon.messages import Process
from calm_edge.recording.window_record import FrameKey, WindowRecord, frame_key, rebuild
from calm_edge.types import SubmapWindow
from device.frame import Frame


def kept_frames(keys: Iterable[FrameKey], window: WindowRecord) -> set[FrameKey]:
    """The frames among `keys` that the estimator keeps after `window`: those of the window, and
    keyframes of later ones. Both ends of the pipe apply it.
    """
    own, newest_ns = set(window.frame_keys), window.t_ns[window.n_primary - 1]
    return {key for key in keys if key in own or key[2] > newest_ns}


class ReceivedFrames:
    """Owner of the frames; windows are put together from them."""

    def __init__(self) -> None:
        self._frames: dict[FrameKey, Frame] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def add(self, frame: Frame) -> None:
        """Keep a frame."""
        self._frames[frame_key(frame)] = frame

    def window(self, message: Process) -> SubmapWindow:
        """The window of a message."""
        for frame in message.frames:
            self.add(frame)
        window = rebuild(message.window, lambda *key: self._frames[key])
        self._frames = {key: self._frames[key] for key in kept_frames(self._frames, message.window)}
        return window
