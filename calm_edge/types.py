"""The nouns of calm-edge. Frozen: only these cross queues and processes.

Frames: w world, s sub-map, c camera, p primary, a assistant. `T_a_b` takes b to a.
Lengths: the *raw unit* is whatever a backbone solved a sub-map in; *map units* are camera
spacings; *world units* are metres when `scale.spacing_m` is set, else map units. Times are
host-monotonic nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera
from device.frame import Frame

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int = NDArray[np.int64]
Int32 = NDArray[np.int32]
Bytes = NDArray[np.uint8]


class CalmEdgeError(Exception):
    """Anything a user can mend; its text is one line naming the thing and the mend."""


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A frame worth reconstructing. `id` counts the keyframes of its own eye from 0."""

    id: int
    frame: Frame


@dataclass(frozen=True, slots=True)
class SubmapWindow:
    """The keyframes of both eyes that become one sub-map (paper IV-A).

    n_overlap: how many leading primary keyframes were the previous window's last.
    loop_keyframe: a historical primary keyframe appended to the batch (IV-D), or None.
    """

    submap_id: int
    primary: tuple[Keyframe, ...]
    assistant: tuple[Keyframe, ...]
    n_overlap: int
    loop_keyframe: Keyframe | None = None

    def keyframes(self) -> tuple[Keyframe, ...]:
        """Batch order everywhere: primary, assistant, then the loop keyframe."""
        loop = (self.loop_keyframe,) if self.loop_keyframe else ()
        return self.primary + self.assistant + loop


@dataclass(frozen=True, slots=True)
class KitBelief:
    """A Gaussian over what stays constant in one kit: the optics of both eyes, the rig, and how
    late the assistant's stamps are.

    mean: (D,) information: (D, D). Entries as in `kit/layout.py`.
    """

    mean: Float
    information: Float


@dataclass(frozen=True, slots=True)
class Hints:
    """What the caller knows of a batch of N images.

    eyes: (N,) Eye values. t_ns: (N,). hfov_deg: one an eye, None where unknown.
    kit: what earlier windows of the same kit taught, or None.
    sizes: (2, 2) width, height [px] of each eye's pictures, None where not known.
    loop: the batch ends with a loop keyframe, a primary view behind the assistant's (IV-D).
    """

    eyes: Int
    t_ns: Int
    hfov_deg: tuple[float | None, float | None] = (None, None)
    kit: KitBelief | None = None
    sizes: Int | None = None
    loop: bool = False


@dataclass(frozen=True, slots=True)
class Landmarks:
    """Sparse points of a sub-map and the pixels that saw them: its matches.

    points_s: (M, 3) raw unit, sub-map frame. index: (O,) landmark of each observation.
    view: (O,) batch index of the image. uv: (O, 2) pixels of the full image.
    sigma_px: (O,) one sigma of uv, an axis; None where all are alike.
    """

    points_s: Float
    index: Int
    view: Int
    uv: Float32
    sigma_px: Float32 | None = None


@dataclass(frozen=True, slots=True)
class Prediction:
    """What a backbone says of N images: the paper's (K, T, D, C), section III.

    cameras: N, of the full image. T_s_c: (N, 4, 4) camera->sub-map, OpenCV axes.
    depth: (N, h, w) z-depth in the sub-map's own unit, 0 unknown; h, w may be smaller
    than the image, pixel centres scale as cv2.resize does. None until densified.
    confidence: (N, h, w) in [0, 1], larger is better; None with depth.
    focal_log_sigma: (N,) one sigma of log focal, None where the model has no idea of it.
    kit: this batch's own evidence on the kit (without the hints), or None.
    assistant_late_s: how much later than stamped, on the primary's clock, assistants were exposed.
    stamps_off_s: (A,) how much later than that each was, None where stamps are even.
    loop_found: False where the trailing loop keyframe could not be placed: its pose says nothing.
    notices: lines for the user, the same for every such batch.
    """

    cameras: tuple[Camera, ...]
    T_s_c: Float
    depth: Float32 | None = None
    confidence: Float32 | None = None
    focal_log_sigma: Float | None = None
    landmarks: Landmarks | None = None
    kit: KitBelief | None = None
    assistant_late_s: float = 0.0
    stamps_off_s: Float | None = None
    loop_found: bool = True
    notices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Submap:
    """A placed sub-map. Pixels and depth live in the log, not here.

    primary_ids / assistant_ids: keyframe ids in batch order. t_ns: (N,) of that order.
    T_s_c_raw: (N, 4, 4), cameras_raw: N, as the backbone gave them, kept so that they can be
    rectified again. T_s_c: (N, 4, 4) rectified, in world units. cameras: N, rectified.
    scale: world units a raw unit; depth is multiplied by it. T_w_s: (4, 4).
    focal_log_sigma: (2,) an eye, as believed when the sub-map was placed.
    assistant_late_ns, stamps_off_ns: see Prediction.assistant_late_s, stamps_off_s.
    """

    id: int
    primary_ids: tuple[int, ...]
    assistant_ids: tuple[int, ...]
    n_overlap: int
    t_ns: Int
    T_s_c_raw: Float
    cameras_raw: tuple[Camera, ...]
    T_s_c: Float
    cameras: tuple[Camera, ...]
    scale: float
    T_w_s: Float
    focal_log_sigma: Float
    assistant_late_ns: int = 0
    stamps_off_ns: Int | None = None

    @property
    def n_primary(self) -> int:
        return len(self.primary_ids)

    @property
    def exposed_ns(self) -> Int:
        """(N,) t_ns, the assistant's brought to the primary's clock and beat."""
        late = np.zeros(len(self.t_ns), np.int64)
        off = 0 if self.stamps_off_ns is None else self.stamps_off_ns
        end = self.n_primary + len(self.assistant_ids)
        late[self.n_primary : end] = self.assistant_late_ns + off
        return self.t_ns + late

    def T_w_c(self) -> Float:
        """(N, 4, 4) camera->world of every view, batch order."""
        return np.asarray(self.T_w_s @ self.T_s_c)


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """The primary keyframe `query_id` saw `match_id` again. T_match_query: (4, 4) world units."""

    query_id: int
    match_id: int
    T_match_query: Float


@dataclass(frozen=True, slots=True)
class GlobalIntrinsics:
    """What the online search holds true of each eye (V-A): K_global and how far to trust it.

    cameras: one an eye. damping: (2,) multiples of 0.1 in [0, 1] (V-C). focal_log_sigma: (2,) one
    sigma of log focal, inf where no matrix could tell.
    """

    cameras: tuple[Camera, Camera]
    damping: Float
    focal_log_sigma: Float

    @property
    def focals(self) -> Float:
        """(2,) fx [px] of each eye."""
        return np.array([camera.fx for camera in self.cameras])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Primary keyframe poses in the world: keyframe_ids (N,), t_ns (N,), T_w_c (N, 4, 4).

    T_p_a: (4, 4) world units. epoch: grows each time poses already published moved.
    """

    keyframe_ids: Int
    t_ns: Int
    T_w_c: Float
    T_p_a: Float
    epoch: int


class PoseStatus(StrEnum):
    LIVE = "live"
    LAGGING = "lagging"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class PoseSample:
    """The pose that leaves the car, of one primary frame.

    T_w_c: (4, 4) primary camera->world, world units. velocity_c: (3,) world units/s, camera
    axes. covariance: (6, 6) of (translation, rotation) in camera axes, world units and rad.
    turn_rate_c: (3,) rad/s. twist_covariance: (6, 6) of (velocity_c, turn_rate_c). Camera axes;
    NaN where unknown.
    """

    t_ns: int
    T_w_c: Float
    velocity_c: Float
    covariance: Float
    epoch: int
    status: PoseStatus
    turn_rate_c: Float = field(default_factory=lambda: np.full(3, np.nan))
    twist_covariance: Float = field(default_factory=lambda: np.full((6, 6), np.nan))


@dataclass(frozen=True, slots=True)
class AnchorTable:
    """Anchors of one sub-map, as rows (paper VI-A, VI-B).

    anchor: (R,) ids over the whole drive. p_s: (R, 3) world units, sub-map frame. Observations:
    seen_anchor (Q,), seen_view (Q,) batch index, uv (Q, 2) px.
    """

    anchor: Int
    p_s: Float
    seen_anchor: Int32
    seen_view: Int32
    uv: Float32


@dataclass(frozen=True, slots=True)
class MapTile:
    """A piece of the map: points_w (P, 3) float32 world units, color (P, 3) uint8 RGB."""

    points_w: Float32
    color: Bytes


@dataclass(frozen=True, slots=True)
class LocalizerUpdate:
    """What one processed window changed: the new sub-map and every pose that is new.

    trajectory: the keyframes that are new or moved; all of them when its epoch grew.
    stage_ms: stage name -> milliseconds. kit: belief after this window. notices: lines for the
    user. loop: what IV-D closed.
    loop_keyframe: the picture it joined to the batch, for the window's record.
    """

    submap: Submap
    prediction: Prediction
    trajectory: Trajectory
    stage_ms: dict[str, float] = field(default_factory=dict)
    kit: KitBelief | None = None
    notices: tuple[str, ...] = ()
    loop: LoopClosure | None = None
    loop_keyframe: Keyframe | None = None
