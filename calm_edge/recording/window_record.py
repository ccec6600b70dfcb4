"""Record of a window's frames, from which a recording rebuilds the window exactly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calm_edge.config import Config
from calm_edge.types import Hints, Int, Keyframe, LocalizerUpdate, SubmapWindow
from device.frame import Eye, Frame

# eye, sequence and t_ns identify a frame
FrameKey = tuple[int, int, int]


def frame_key(frame: Frame) -> FrameKey:
    """Return the key (eye, sequence, t_ns) that identifies a frame in records."""
    return int(frame.eye), frame.sequence, frame.t_ns


@dataclass(frozen=True, slots=True)
class WindowRecord:
    """A SubmapWindow without its images (paper IV-A).

    ids, eyes, sequences, t_ns: (N,) of its keyframes: n_primary of the primary camera, then those
    of the assistant. The first n_overlap are shared with the previous window. has_loop: one more
    primary keyframe is last, an earlier one for loop closure (IV-D).
    """

    submap_id: int
    n_primary: int
    n_overlap: int
    has_loop: bool
    ids: Int
    eyes: Int
    sequences: Int
    t_ns: Int

    @property
    def frame_keys(self) -> tuple[FrameKey, ...]:
        """The key (eye, sequence, t_ns) of each keyframe, in the order of the arrays."""
        columns = (self.eyes.tolist(), self.sequences.tolist(), self.t_ns.tolist())
        return tuple(zip(*columns, strict=True))


def of_window(window: SubmapWindow) -> WindowRecord:
    """Create the record of a window."""
    keyframes = window.keyframes()
    return WindowRecord(
        window.submap_id,
        len(window.primary),
        window.n_overlap,
        window.loop_keyframe is not None,
        np.array([k.id for k in keyframes], np.int64),
        np.array([k.frame.eye for k in keyframes], np.int64),
        np.array([k.frame.sequence for k in keyframes], np.int64),
        np.array([k.frame.t_ns for k in keyframes], np.int64),
    )


def rebuild(record: WindowRecord, frame: Callable[[Eye, int, int], Frame]) -> SubmapWindow:
    """Rebuild a window from its record.

    frame: `frame(eye, sequence, t_ns)` reads one frame; its exceptions propagate.
    """
    keyframes = [
        Keyframe(i, frame(Eye(eye), sequence, t_ns))
        for i, (eye, sequence, t_ns) in zip(record.ids.tolist(), record.frame_keys, strict=True)
    ]
    loop = keyframes.pop() if record.has_loop else None
    return SubmapWindow(
        record.submap_id,
        tuple(keyframes[: record.n_primary]),
        tuple(keyframes[record.n_primary :]),
        record.n_overlap,
        loop,
    )


def window_hints(record: WindowRecord, update: LocalizerUpdate, config: Config) -> Hints:
    """Hints for the backbone to compute the depth of a solved window, or to solve it again.

    update: the result of the window, whose belief on the kit is used.
    """
    return Hints(
        record.eyes,
        record.t_ns,
        config.backbone.hfov_of_eye,
        update.kit,
        config.capture.readout_s_of_eye,
        loop=record.has_loop,
        n_overlap=record.n_overlap,
        n_shared=config.overlap_shared,
        masks=update.masks,
    )
