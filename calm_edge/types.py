"""Data types that are passed between modules and processes; all are frozen.

Frames: w world, s sub-map, c camera, p primary, a assistant. `T_a_b` maps b-coordinates to a.
Lengths: *raw units* are those in which a backbone solved a sub-map; *map units* are camera
spacings; *world units* are metres if `scale.spacing_m` is set, else map units. Times are
host-monotonic nanoseconds.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
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
    """An error that the user can fix; its text is one line that names the fault and the remedy."""


@dataclass(frozen=True, slots=True)
class Keyframe:
    """A frame selected for reconstruction. id: counted from 0 for each camera."""

    id: int
    frame: Frame


@dataclass(frozen=True, slots=True)
class SubmapWindow:
    """Keyframes of both cameras that are reconstructed as one sub-map (paper IV-A).

    n_overlap: number of leading primary keyframes shared with the end of the previous window.
    loop_keyframe: an earlier primary keyframe appended to the batch for loop closure (IV-D), or
    None.
    """

    submap_id: int
    primary: tuple[Keyframe, ...]
    assistant: tuple[Keyframe, ...]
    n_overlap: int
    loop_keyframe: Keyframe | None = None

    def keyframes(self) -> tuple[Keyframe, ...]:
        """All keyframes in batch order: primary, assistant, then the loop keyframe."""
        loop = (self.loop_keyframe,) if self.loop_keyframe else ()
        return self.primary + self.assistant + loop


@dataclass(frozen=True, slots=True)
class Masks:
    """What is left out of the pictures of each eye, `geometry/picture_mask`; None: nothing."""

    primary: Bytes | None = None
    assistant: Bytes | None = None

    def of_eye(self, eye: int) -> Bytes | None:
        """Mask of one eye."""
        return self.assistant if eye else self.primary


@dataclass(frozen=True, slots=True)
class KitBelief:
    """Gaussian over the constants of a kit: optics of both cameras, rig, and time offset.

    mean: (D,). information: (D, D) inverse covariance, or only the weight if `noise` is given.
    Entries as in `kit/layout.py`. noise: (D, D) covariance of information times the mean's error,
    as far as it is independent from window to window; None if it is the information. measured:
    (D, D) part of the information that windows gave. common: of the error that all windows share,
    the same covariance as a multiple of `measured`.
    """

    mean: Float
    information: Float
    noise: Float | None = None
    measured: Float | None = None
    common: float = 0.0


@dataclass(frozen=True, slots=True)
class Overlap:
    """Gaussian on the poses of F primary keyframes that two consecutive windows share.

    From what the earlier window measures and the later one does not, given the kit.
    t_ns: (F,) stamps. T_first_k: (F, 4, 4) poses relative to the first, as solved, in spacings.
    kit: (D,) as solved (`kit/layout.py`). The mean of T_k_first for a kit is
    exp(offset + by_kit (kit - self.kit)) T_first_k^-1, with offset (6 F - 6,) and by_kit
    (6 F - 6, D) for all k but the first. information: (6 F - 6, 6 F - 6) of these twists.
    """

    t_ns: Int
    T_first_k: Float
    kit: Float
    offset: Float
    by_kit: Float
    information: Float


@dataclass(frozen=True, slots=True)
class PathLength:
    """Length of the path through F consecutive primary keyframes, by another window with them.

    t_ns: (F,) stamps. spacings: the length. log_sigma: of its log, the kit's part included.
    """

    t_ns: Int
    spacings: float
    log_sigma: float


@dataclass(frozen=True, slots=True)
class Hints:
    """Prior knowledge of a batch of N images.

    eyes: (N,) Eye values. t_ns: (N,). hfov_deg: one per camera, None if unknown. readout_s: from
    the exposure of the first row to that of the last, one per camera, None if unknown.
    kit: belief from earlier windows with the same kit, or None.
    sizes: (2, 2) width, height [px] of each camera's images, or None.
    late_s: (N,) known offset of each stamp, exposure minus stamp; None if none is known.
    late_sigma_s: sigma of that offset, common to all stamps of the assistant.
    apart: whether `Prediction.T_s_c_apart` is wanted.
    loop: the last image is a loop keyframe, a primary view after those of the assistant (IV-D).
    n_overlap: number of leading primary images that the previous batch ended with. overlap: its
    estimate of them, or None. n_shared: number of last primary images of which the next
    batch wants an overlap; 0: none.
    travel: (3,) direction of travel of earlier batches, unit vector in the primary's axes, or None.
    masks: parts of the images that show no scene, or None.
    lengths: by the neighbouring batches, as far as they are solved.
    lenses: known lens of each camera, or None: a backbone that models pinhole cameras only
    gets pictures undistorted by it.
    """

    eyes: Int
    t_ns: Int
    hfov_deg: tuple[float | None, float | None] = (None, None)
    kit: KitBelief | None = None
    readout_s: tuple[float | None, float | None] = (None, None)
    sizes: Int | None = None
    loop: bool = False
    n_overlap: int = 0
    overlap: Overlap | None = None
    n_shared: int = 0
    late_s: Float | None = None
    late_sigma_s: float = 0.0
    apart: bool = False
    travel: Float | None = None
    masks: Masks | None = None
    lengths: tuple[PathLength, ...] = ()
    lenses: tuple[Camera | None, Camera | None] = (None, None)

    def without_loop(self) -> Hints:
        """Hints of the window alone."""
        late_s = None if self.late_s is None else self.late_s[:-1]
        return replace(self, eyes=self.eyes[:-1], t_ns=self.t_ns[:-1], late_s=late_s, loop=False)

    def without_neighbours(self) -> Hints:
        """Hints without what neighbouring batches say of shared keyframes."""
        return replace(self, overlap=None, lengths=())


@dataclass(frozen=True, slots=True)
class Landmarks:
    """Sparse points of a sub-map and their observations.

    points_s: (M, 3) sub-map frame, raw units. index: (O,) landmark of each observation.
    view: (O,) batch index of the image. uv: (O, 2) pixels of the full image.
    sigma_px: (O,) sigma of uv per axis; None if equal for all.
    edge: (O, 2) direction of an edge of the picture that an observation lies on, times the root of
    1 - sigma_px / its sigma along the edge; None if all are corners.
    """

    points_s: Float
    index: Int
    view: Int
    uv: Float32
    sigma_px: Float32 | None = None
    edge: Float32 | None = None

    def seen_by(self, view: int) -> Int:
        """Landmarks that a view observed, in order."""
        return np.unique(self.index[self.view == view])

    def unseen_by(self, view: int) -> Landmarks:
        """The other landmarks with their observations."""
        gone = self.seen_by(view)
        kept = np.setdiff1d(np.arange(len(self.points_s)), gone)
        rows = ~np.isin(self.index, gone)
        return Landmarks(
            self.points_s[kept],
            np.searchsorted(kept, self.index[rows]),
            self.view[rows],
            self.uv[rows],
            None if self.sigma_px is None else self.sigma_px[rows],
            None if self.edge is None else self.edge[rows],
        )


@dataclass(frozen=True, slots=True)
class Prediction:
    """Output of a backbone for N images: intrinsics, poses, depth and its confidence (paper III).

    cameras: N, of the full image. T_s_c: (N, 4, 4) camera->sub-map, OpenCV axes, raw units.
    depth: (N, h, w) z-depth in raw units, 0 unknown; h, w may be smaller than the image, with
    pixel centres as in cv2.resize. None before `densify`.
    confidence: (N, h, w) of depth in [0, 1], larger is better; None if depth is None.
    focal_log_sigma: (N,) sigma of the log focal length; None if the model does not estimate it.
    scale_log_sigma: sigma of the log of the window's length, given the spacing between the cameras;
    None if the model does not estimate it.
    covariance: (6 P, 6 P) of the poses of the P primary views relative to the first, (translation,
    rotation) in each view's own axes, given the spacing, raw units and rad; or None.
    kit: evidence of this batch on the kit, without the prior in the hints; or None.
    assistant_late_s: time offset: how much later than its stamp, on the primary's clock, the
    assistant is exposed. stamps_off_s: (A,) what has to be added to that for each assistant
    view; None if its stamps need no correction of their own.
    kit_sigma: (2,) of the belief on the kit by which the pictures were matched, as in
    `ResolvingBackbone.kit_sigma`; None if the backbone has no such belief.
    overlap: estimate of the last primary images for the next batch (`Hints.n_shared`), or None.
    overlap_mismatch: chi-square of the hints' overlap against these images alone, by degree of
    freedom; None without one.
    drawn: (2,) factors by which the hints' overlap changed the differences of translations and of
    rotations from the previous batch; None without one.
    T_s_c_apart: poses of the window's own views in a frame and unit of their own, not tied by the
    stamps: those of the assistant by its pictures alone, NaN where that fails; or None.
    loop_found: False if the loop keyframe could not be placed; its pose is then meaningless.
    notices: lines for the user; a line repeated by later batches is reported once.
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
    kit_sigma: Float | None = None
    overlap: Overlap | None = None
    overlap_mismatch: float | None = None
    drawn: Float | None = None
    loop_found: bool = True
    notices: tuple[str, ...] = ()
    scale_log_sigma: float | None = None
    covariance: Float32 | None = None
    T_s_c_apart: Float | None = None

    def without_loop(self) -> Prediction:
        """Prediction of the window alone, without the landmarks triangulated for the loop view."""
        marks, sigma = self.landmarks, self.focal_log_sigma
        return replace(
            self,
            cameras=self.cameras[:-1],
            T_s_c=self.T_s_c[:-1],
            depth=None if self.depth is None else self.depth[:-1],
            confidence=None if self.confidence is None else self.confidence[:-1],
            focal_log_sigma=None if sigma is None else sigma[:-1],
            landmarks=None if marks is None else marks.unseen_by(len(self.cameras) - 1),
            loop_found=True,
        )


@dataclass(frozen=True, slots=True)
class Submap:
    """A placed sub-map, without images and depth.

    primary_ids, assistant_ids: keyframe ids in batch order. t_ns: (N,) in batch order, a loop
    view included. T_s_c_raw: (N, 4, 4) and cameras_raw: output of the backbone in raw units, kept
    for rectifying again. T_s_c: (N, 4, 4) and cameras: rectified, in world units.
    scale: world units per raw unit, also of depth. T_w_s: (4, 4) sub-map->world.
    focal_log_sigma: (2,) sigma of each camera's log focal length when the sub-map was placed.
    assistant_late_ns: time offset, how much later than its stamp the assistant is exposed.
    stamps_off_ns: (A,) additional offset of each assistant view, or None.
    scale_log_sigma: sigma of the log of the sub-map's length, given the spacing; inf if unknown.
    kit_epoch: how often the kit had changed before it in this drive, e.g. by a mount that slipped.
    drawn: (2,) as of the Prediction, or None. cuts: primary views that no picture connects with
    those before. bridged_s: time for which constant velocity was assumed before the sub-map, 0 if
    it has keyframes of an earlier one.
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
    scale_log_sigma: float = np.inf
    kit_epoch: int = 0
    drawn: Float | None = None
    cuts: tuple[int, ...] = ()
    bridged_s: float = 0.0

    @property
    def n_primary(self) -> int:
        return len(self.primary_ids)

    @property
    def exposed_ns(self) -> Int:
        """Times of exposure (N,): t_ns, those of the assistant corrected by the time offset."""
        late = np.zeros(len(self.t_ns), np.int64)
        off = 0 if self.stamps_off_ns is None else self.stamps_off_ns
        end = self.n_primary + len(self.assistant_ids)
        late[self.n_primary : end] = self.assistant_late_ns + off
        return self.t_ns + late

    @property
    def late_ns(self) -> int:
        """Mean time from the stamps of the assistant's views to their exposure; 0 without one."""
        views = slice(self.n_primary, self.n_primary + len(self.assistant_ids))
        late = (self.exposed_ns - self.t_ns)[views]
        return round(float(late.mean())) if len(late) else 0

    def without_loop(self) -> Submap:
        """The window's views alone."""
        return replace(
            self,
            t_ns=self.t_ns[:-1],
            T_s_c_raw=self.T_s_c_raw[:-1],
            cameras_raw=self.cameras_raw[:-1],
            T_s_c=self.T_s_c[:-1],
            cameras=self.cameras[:-1],
        )

    def T_w_c(self) -> Float:
        """Poses camera->world (N, 4, 4) of all views, in batch order."""
        return np.asarray(self.T_w_s @ self.T_s_c)


# Above this sigma of the log scale, lengths are not metric.
METRIC_LOG_SIGMA = 0.10


@dataclass(frozen=True, slots=True)
class Metre:
    """How well lengths are known, given the true spacing between the cameras.

    log_sigma: sigma of the log scale; inf if unknown. reason: one sentence that says why lengths
    are not metric; empty if they are.
    """

    log_sigma: float = np.inf
    reason: str = ""

    @property
    def metric(self) -> bool:
        """Whether lengths are known well enough to be reported."""
        return self.log_sigma <= METRIC_LOG_SIGMA

    def summary(self) -> dict[str, float | str | None]:
        """JSON object: `sigma_percent`, None if unknown, and `reason`."""
        sigma = 100 * self.log_sigma if np.isfinite(self.log_sigma) else None
        return {"sigma_percent": sigma, "reason": self.reason}


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """Relative pose of two primary keyframes that show one place.

    T_match_query: (4, 4) from keyframe `query_id`, in the new sub-map, to the earlier `match_id`;
    world units.
    """

    query_id: int
    match_id: int
    T_match_query: Float


@dataclass(frozen=True, slots=True)
class GlobalIntrinsics:
    """Intrinsics of both cameras, estimated from the sub-maps so far (K_global of paper V-A).

    cameras: primary, assistant. damping: (2,) share of each focal's error to correct, 0 to 1 in
    steps of 0.1 (V-C).
    focal_log_sigma: (2,) sigma of the log focal length, inf if no fundamental matrix determines it.
    """

    cameras: tuple[Camera, Camera]
    damping: Float
    focal_log_sigma: Float

    @property
    def focals(self) -> Float:
        """Focal lengths fx (2,) [px] of primary and assistant."""
        return np.array([camera.fx for camera in self.cameras])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Poses of primary keyframes: keyframe_ids (N,), t_ns (N,), T_w_c (N, 4, 4), world units.

    T_p_a: (4, 4) rig. epoch: incremented whenever poses already published have moved.
    """

    keyframe_ids: Int
    t_ns: Int
    T_w_c: Float
    T_p_a: Float
    epoch: int


class PoseStatus(StrEnum):
    """Status of a live pose.

    LAGGING: relative to an old sub-map. UNSCALED: its lengths are not metric, however well the pose
    is known otherwise. LOST: no pose.
    """

    LIVE = "live"
    LAGGING = "lagging"
    UNSCALED = "unscaled"
    LOST = "lost"

    @property
    def usable(self) -> bool:
        """Whether there is a pose in lengths that are known."""
        return self in (PoseStatus.LIVE, PoseStatus.LAGGING)


@dataclass(frozen=True, slots=True)
class PoseSample:
    """Live pose of one primary frame, as published.

    T_w_c: (4, 4) primary camera->the tracker's odometry frame, in which the pose does not jump when
    a sub-map arrives; `Attached.T_map_odom` takes it to the world. velocity_c: (3,) and
    turn_rate_c: (3,) rad/s, camera axes. covariance: (6, 6) of (translation, rotation), relative to
    the sub-map it was tracked in,
    twist_covariance: (6, 6) of (velocity_c, turn_rate_c), camera axes, both given the scale; see
    `with_drift`. World units and rad; NaN if unknown.
    scale_log_sigma: sigma of the log of lengths at present, given the spacing; inf if unknown.
    Since the first metric pose of the epoch, camera axes: drift, the (6, 6) covariance of the
    motion given scale and focal length; scale_offset (3,) and focal_offset (6,), how far the pose
    moves for one sigma of either.
    """

    t_ns: int
    T_w_c: Float
    velocity_c: Float
    covariance: Float
    epoch: int
    status: PoseStatus
    turn_rate_c: Float = field(default_factory=lambda: np.full(3, np.nan))
    twist_covariance: Float = field(default_factory=lambda: np.full((6, 6), np.nan))
    scale_log_sigma: float = np.inf
    scale_offset: Float = field(default_factory=lambda: np.zeros(3))
    focal_offset: Float = field(default_factory=lambda: np.zeros(6))
    drift: Float = field(default_factory=lambda: np.zeros((6, 6)))

    def with_drift(self) -> tuple[Float, Float]:
        """Covariances (6, 6) of the pose since the first metric one, and of the twist.

        With the error of the scale, which stretches the path and the velocity. NaN if unknown.
        """
        if not np.isfinite(self.scale_log_sigma):
            return np.full((6, 6), np.nan), np.full((6, 6), np.nan)
        pose, twist = self.covariance.copy(), self.twist_covariance.copy()
        pose += self.drift + np.outer(self.focal_offset, self.focal_offset)
        pose[:3, :3] += np.outer(self.scale_offset, self.scale_offset)
        faster = self.scale_log_sigma * self.velocity_c
        twist[:3, :3] += np.outer(faster, faster)
        return pose, twist


@dataclass(frozen=True, slots=True)
class AnchorTable:
    """Anchors of one sub-map, i.e. 3-D points seen in several views (paper VI-A, VI-B).

    anchor: (R,) ids, unique over the drive. p_s: (R, 3) sub-map frame, world units. Observations:
    seen_anchor (Q,), seen_view (Q,) batch index, uv (Q, 2) px.
    """

    anchor: Int
    p_s: Float
    seen_anchor: Int32
    seen_view: Int32
    uv: Float32

    @classmethod
    def empty(cls) -> AnchorTable:
        """A table without rows."""
        unseen = np.empty(0, np.int32)
        return cls(
            np.empty(0, np.int64), np.empty((0, 3)), unseen, unseen, np.empty((0, 2), np.float32)
        )

    @classmethod
    def joined(cls, tables: Iterable[AnchorTable]) -> AnchorTable:
        """The rows of all tables in the given order."""
        tables = [cls.empty(), *tables]
        return cls(*(np.concatenate([getattr(t, name) for t in tables]) for name in cls.__slots__))


@dataclass(frozen=True, slots=True)
class MapTile:
    """Points of one sub-map in the map: points_w (P, 3) world units, color (P, 3) RGB."""

    points_w: Float32
    color: Bytes


@dataclass(frozen=True, slots=True)
class LocalizerUpdate:
    """Result of processing one window: the new sub-map, and new and changed poses.

    trajectory: keyframes that are new or have moved; all of them if the epoch has changed.
    stage_ms: stage name -> milliseconds. kit: belief after this window. notices: lines for the
    user. loop: loop closure found (IV-D). loop_keyframe: the earlier keyframe that was appended to
    the batch, for the record of the window. metre: of the drive after this window. masks: parts of
    the pictures that show no scene, as known then.
    """

    submap: Submap
    prediction: Prediction
    trajectory: Trajectory
    stage_ms: dict[str, float] = field(default_factory=dict)
    kit: KitBelief | None = None
    notices: tuple[str, ...] = ()
    loop: LoopClosure | None = None
    loop_keyframe: Keyframe | None = None
    metre: Metre = field(default_factory=Metre)
    masks: Masks | None = None

    @property
    def scale_log_sigma(self) -> float:
        """Sigma of the log of lengths in the sub-map; inf also if the drive as a whole has none."""
        return self.submap.scale_log_sigma if np.isfinite(self.metre.log_sigma) else np.inf
