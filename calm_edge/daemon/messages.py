"""What crosses the pipes between the processes. Frozen, and small but for windows and updates."""

from __future__ import annotations

from dataclasses import dataclass, replace

from calm_edge.recording.window_record import WindowRecord
from calm_edge.types import Float, LocalizerUpdate, PoseSample, Submap, SubmapWindow, Trajectory
from device.frame import Eye, Frame


@dataclass(frozen=True, slots=True)
class Ready:
    """The child is set up and waits for work. expects_pictures: Expect is of use to it."""

    expects_pictures: bool = False


@dataclass(frozen=True, slots=True)
class Refused:
    """The child cannot be set up; reason is one line for the user."""

    reason: str


@dataclass(frozen=True, slots=True)
class Counters:
    """What a tracker counts on from: the next ids, and the epoch of its poses."""

    keyframe_id: int = 0
    assistant_id: int = 0
    submap_id: int = 0
    epoch: int = 0

    def after_window(self, window: SubmapWindow) -> Counters:
        """The next ids once a window is out."""
        keyframes = [self.keyframe_id, *(k.id + 1 for k in window.primary)]
        assistants = [self.assistant_id, *(k.id + 1 for k in window.assistant)]
        return Counters(max(keyframes), max(assistants), window.submap_id + 1, self.epoch)

    def after_epoch(self, epoch: int) -> Counters:
        """A pose of `epoch` is out."""
        return replace(self, epoch=epoch)

    def after_death(self) -> Counters:
        """The next tracker's poses are in a frame of their own."""
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
    """The pose of a primary frame, ahead of all else that the frame leads to."""

    sample: PoseSample


@dataclass(frozen=True, slots=True)
class Tracked:
    """What a frame led to: its slot is free again.

    keyframe: the frame itself, where it became one. problem: why it could not be used, or empty.
    late: it got no pose, for it waited too long.
    """

    slot: int
    windows: tuple[SubmapWindow, ...]
    keyframe: Frame | None = None
    problem: str = ""
    late: bool = False


@dataclass(frozen=True, slots=True)
class Attach:
    """A sub-map for the tracker to follow from now on."""

    update: LocalizerUpdate


@dataclass(frozen=True, slots=True)
class Attached:
    """taken: the sub-map's points reach the newest frame. T_map_odom (4, 4): map<-live poses."""

    submap_id: int
    taken: bool
    T_map_odom: Float


@dataclass(frozen=True, slots=True)
class Lagging:
    """The estimator is behind, or no longer."""

    lagging: bool


@dataclass(frozen=True, slots=True)
class Sparse:
    """Half as many keyframes from now on, or all again."""

    sparse: bool


@dataclass(frozen=True, slots=True)
class MakeDepth:
    """Depth is made where the configuration asks for it, or left to `map`."""

    on: bool


@dataclass(frozen=True, slots=True)
class Flush:
    """No more frames: give the windows that remain."""


@dataclass(frozen=True, slots=True)
class Flushed:
    """The remaining windows."""

    windows: tuple[SubmapWindow, ...]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A window that only `map` will see. t_ns: stamps of its primary keyframes."""

    submap_id: int
    t_ns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Expect:
    """A primary keyframe of a window to come: what it needs may begin."""

    keyframe: Frame


@dataclass(frozen=True, slots=True)
class Process:
    """A window for the estimator. left_out: those since the last one that it never gets."""

    window: SubmapWindow
    left_out: tuple[LeftOut, ...] = ()


@dataclass(frozen=True, slots=True)
class Processed:
    """What a window changed; update is None when it could not be solved, and problem says why.

    window: the record anew, where a loop keyframe joined it.
    """

    submap_id: int
    update: LocalizerUpdate | None
    problem: str = ""
    window: WindowRecord | None = None


@dataclass(frozen=True, slots=True)
class Finish:
    """No more windows: the joint optimum."""


@dataclass(frozen=True, slots=True)
class Finished:
    """Every sub-map where it finally is, and the trajectory; None without a single sub-map."""

    submaps: tuple[Submap, ...]
    trajectory: Trajectory | None


@dataclass(frozen=True, slots=True)
class Stop:
    """End the process."""
