"""Messages between the processes of `record`, frozen.

Pictures reach the tracker in shared memory (`ring`), the estimator with Expect or Process, once
each; windows name them by key.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from calm_edge.recording.window_record import FrameKey, WindowRecord
from calm_edge.types import Float, LocalizerUpdate, PoseSample, Submap, Trajectory
from device.frame import Eye, Frame


@dataclass(frozen=True, slots=True)
class Ready:
    """The child is set up and waits for work. expects_pictures: it makes use of Expect."""

    expects_pictures: bool = False


@dataclass(frozen=True, slots=True)
class Refused:
    """The child cannot be set up; reason is one line for the user."""

    reason: str


@dataclass(frozen=True, slots=True)
class Counters:
    """Where a tracker starts counting: the next ids, and the epoch of its poses."""

    keyframe_id: int = 0
    assistant_id: int = 0
    submap_id: int = 0
    epoch: int = 0

    def after_window(self, window: WindowRecord) -> Counters:
        """The next ids after a completed window."""
        primary, assistant = window.ids[: window.n_primary], window.ids[window.n_primary :]
        keyframe_id = max(self.keyframe_id, int(primary.max()) + 1)
        assistant_id = max(self.assistant_id, int(assistant.max(initial=-1)) + 1)
        return Counters(keyframe_id, assistant_id, window.submap_id + 1, self.epoch)

    def after_epoch(self, epoch: int) -> Counters:
        """The counters after a pose of `epoch`."""
        return replace(self, epoch=epoch)

    def after_death(self) -> Counters:
        """The counters of the next process, whose poses are in a new coordinate frame."""
        return replace(self, epoch=self.epoch + 1)


@dataclass(frozen=True, slots=True)
class FrameIn:
    """A frame for the tracker; its bytes are the first `size` of `slot` of the ring."""

    eye: Eye
    sequence: int
    t_ns: int
    slot: int
    size: int


@dataclass(frozen=True, slots=True)
class Posed:
    """The pose of a primary frame; sent before the frame's Tracked."""

    sample: PoseSample


@dataclass(frozen=True, slots=True)
class Tracked:
    """A frame was handled and its slot is free.

    windows: those it completed. released: frames that no later window contains. is_keyframe: it is
    a primary keyframe. problem: why it could not be used, or empty. late: it waited too long for a
    pose.
    """

    slot: int
    windows: tuple[WindowRecord, ...]
    released: tuple[FrameKey, ...]
    is_keyframe: bool = False
    problem: str = ""
    late: bool = False


@dataclass(frozen=True, slots=True)
class Attach:
    """A sub-map for the tracker to localise against."""

    update: LocalizerUpdate


@dataclass(frozen=True, slots=True)
class Attached:
    """Answer to Attach. taken: the sub-map's points were tracked to the newest frame.

    T_map_odom: (4, 4), the tracker's odometry in the map.
    """

    submap_id: int
    taken: bool
    T_map_odom: Float


@dataclass(frozen=True, slots=True)
class Lagging:
    """Whether the estimator is behind."""

    lagging: bool


@dataclass(frozen=True, slots=True)
class Sparse:
    """Whether to choose half as many keyframes."""

    sparse: bool


@dataclass(frozen=True, slots=True)
class MakeDepth:
    """Whether to compute the depth that the configuration asks for, or to leave it to `map`."""

    on: bool


@dataclass(frozen=True, slots=True)
class Flush:
    """No more frames: complete the remaining windows."""


@dataclass(frozen=True, slots=True)
class Flushed:
    """The remaining windows."""

    windows: tuple[WindowRecord, ...]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A window left to `map`. t_ns: stamps of its primary keyframes."""

    submap_id: int
    t_ns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Expect:
    """A primary keyframe of a later window, so that its features can be computed early."""

    keyframe: Frame


@dataclass(frozen=True, slots=True)
class Process:
    """A window for the estimator. frames: those of its frames that the process does not have yet.
    left_out: windows since the last one that it does not get.
    """

    window: WindowRecord
    frames: tuple[Frame, ...]
    left_out: tuple[LeftOut, ...] = ()


@dataclass(frozen=True, slots=True)
class Processed:
    """Result of a window.

    update: None if the window could not be solved. problem: why not, else empty. window: the
    window's record with the loop keyframe that was added to it, None without one.
    """

    submap_id: int
    update: LocalizerUpdate | None
    problem: str = ""
    window: WindowRecord | None = None


@dataclass(frozen=True, slots=True)
class Finish:
    """No more windows: compute the joint optimum."""


@dataclass(frozen=True, slots=True)
class Finished:
    """All sub-maps in their final places; trajectory: None without any sub-map."""

    submaps: tuple[Submap, ...]
    trajectory: Trajectory | None


@dataclass(frozen=True, slots=True)
class Stop:
    """End the process."""
