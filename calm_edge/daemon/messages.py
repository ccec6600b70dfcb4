"""Messages between the processes of `calm-edge record`.

The tracker gets its images in shared memory (`ring`). The estimator gets each image once: a primary
keyframe in an Expect, sent as soon as it is selected if the backbone computes features early and no
window is queued; all other frames in the Process of the first window that contains them, sent when
the estimator is idle. Window records refer to frames by key: camera, sequence number and stamp.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from calm_edge.estimator.gaps import Gap
from calm_edge.recording.window_record import FrameKey, WindowRecord
from calm_edge.types import (
    Float,
    Float32,
    KitBelief,
    LocalizerUpdate,
    Masks,
    Metre,
    PoseSample,
    Prediction,
    Submap,
    Trajectory,
)
from device.frame import Eye, Frame


@dataclass(frozen=True, slots=True)
class Ready:
    """The child process waits for work.

    expects_pictures: primary keyframes are to be sent ahead of their window, in Expect.
    """

    expects_pictures: bool = False


@dataclass(frozen=True, slots=True)
class Refused:
    """The child process cannot start. reason: one line for the user."""

    reason: str


@dataclass(frozen=True, slots=True)
class Counters:
    """Ids of the next primary keyframe, assistant keyframe and sub-map, and the poses' epoch.

    A restarted tracker continues from them.
    """

    keyframe_id: int = 0
    assistant_id: int = 0
    submap_id: int = 0
    epoch: int = 0

    def after_window(self, window: WindowRecord) -> Counters:
        """Return the counters after a completed window."""
        primary, assistant = window.ids[: window.n_primary], window.ids[window.n_primary :]
        keyframe_id = max(self.keyframe_id, int(primary.max()) + 1)
        assistant_id = max(self.assistant_id, int(assistant.max(initial=-1)) + 1)
        return Counters(keyframe_id, assistant_id, window.submap_id + 1, self.epoch)

    def after_epoch(self, epoch: int) -> Counters:
        """Return the counters after a pose with this epoch."""
        return replace(self, epoch=epoch)

    def after_death(self) -> Counters:
        """Return the counters for a restarted tracker: a new epoch, as its map frame is new."""
        return replace(self, epoch=self.epoch + 1)


@dataclass(frozen=True, slots=True)
class FrameIn:
    """A frame for the tracker; its JPEG is in the first `size` bytes of the ring's slot `slot`."""

    eye: Eye
    sequence: int
    t_ns: int
    slot: int
    size: int
    own_stamp: bool = True


@dataclass(frozen=True, slots=True)
class Posed:
    """Pose of a primary frame; sent before the Tracked message of that frame.

    moves: now and then the points that gave the pose, (M, 4): their pixel in this frame, then that
    in the frame they were tracked from; empty of a lost pose. None otherwise.
    """

    sample: PoseSample
    moves: Float32 | None = None


@dataclass(frozen=True, slots=True)
class Tracked:
    """The tracker is done with a frame, and its slot is free.

    windows: completed by this frame. released: frames that no later window contains. is_keyframe:
    the frame is a primary keyframe. problem: why the frame could not be decoded, or empty. late:
    no pose was computed for this frame, since newer frames were already waiting. repeat: the
    camera, if its frame repeats the picture before: it gets no pose and is no keyframe. resized:
    a line for the user if the pictures have changed their size, or empty.
    """

    slot: int
    windows: tuple[WindowRecord, ...]
    released: tuple[FrameKey, ...]
    is_keyframe: bool = False
    problem: str = ""
    late: bool = False
    resized: str = ""
    repeat: Eye | None = None


@dataclass(frozen=True, slots=True)
class Event:
    """A moment of the drive that somebody marked. t_ns: on the clock of the frames."""

    t_ns: int
    text: str


@dataclass(frozen=True, slots=True)
class Keep:
    """Request to protect the drive being recorded from removal, or to end that."""

    kept: bool


@dataclass(frozen=True, slots=True)
class Attach:
    """A solved sub-map, relative to which the tracker is to compute its poses."""

    update: LocalizerUpdate


@dataclass(frozen=True, slots=True)
class Attached:
    """Answer to Attach.

    taken: True if the tracker uses the sub-map, i.e. could track its points to the newest frame.
    T_map_odom: (4, 4) from the tracker's odometry frame to the map.
    """

    submap_id: int
    taken: bool
    T_map_odom: Float


@dataclass(frozen=True, slots=True)
class Lagging:
    """Whether many windows wait for the estimator, or the newest gave no sub-map.

    Poses then get the status LAGGING.
    """

    lagging: bool


@dataclass(frozen=True, slots=True)
class Sparse:
    """Whether to select only half as many keyframes, to reduce the load."""

    sparse: bool


@dataclass(frozen=True, slots=True)
class MakeDepth:
    """Whether to compute dense depth, if configured, or leave it for `calm-edge map`."""

    on: bool


@dataclass(frozen=True, slots=True)
class Flush:
    """No more frames: complete the remaining windows."""


@dataclass(frozen=True, slots=True)
class Flushed:
    """Answer to Flush: the remaining windows."""

    windows: tuple[WindowRecord, ...]


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A window left for `calm-edge map`. t_ns: stamps of its primary keyframes."""

    submap_id: int
    t_ns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Expect:
    """A primary keyframe, sent once selected, so that features are computed before its window."""

    keyframe: Frame


@dataclass(frozen=True, slots=True)
class Process:
    """A window for the estimator to solve, sent when it is idle.

    frames: the window's frames except those sent before, in Expect or with an earlier window.
    left_out: windows left for `calm-edge map` since the last Process message.
    """

    window: WindowRecord
    frames: tuple[Frame, ...]
    left_out: tuple[LeftOut, ...] = ()


@dataclass(frozen=True, slots=True)
class Processed:
    """Result of a window.

    update: None if the window could not be solved. problem: the reason, otherwise empty. window:
    record of the window with the loop keyframe that the estimator added, None without one. metre:
    of the drive so far; None if unknown.
    """

    submap_id: int
    update: LocalizerUpdate | None
    problem: str = ""
    window: WindowRecord | None = None
    metre: Metre | None = None


@dataclass(frozen=True, slots=True)
class Finish:
    """No more windows: compute the joint optimum."""


@dataclass(frozen=True, slots=True)
class Finished:
    """Answer to Finish: all sub-maps with their final poses, and the metre of the drive.

    trajectory: None without a sub-map. solved_again: by sub-map id, the solutions of windows that
    have been solved again from their pictures, or for the first time, since their Processed. gaps:
    of the path, which nothing connects. kit: final belief. masks: as in LocalizerUpdate.
    """

    submaps: tuple[Submap, ...]
    trajectory: Trajectory | None
    metre: Metre
    solved_again: dict[int, Prediction] = field(default_factory=dict)
    gaps: tuple[Gap, ...] = ()
    kit: KitBelief | None = None
    masks: Masks | None = None


@dataclass(frozen=True, slots=True)
class Stop:
    """Request to exit."""
