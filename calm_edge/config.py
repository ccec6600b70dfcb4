"""Configuration: a typed section for each part; defaults are the paper's values where given.

Users read the docstrings of the sections (`commands/config_text`): what the section is about, then
lines `key: what it does.` or `key, key: what both do.`
"""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_type_hints

from calm_edge.similar import similar
from calm_edge.typed import coerce
from calm_edge.types import CalmEdgeError
from device.frame import JPEG_QUALITY


@dataclass(frozen=True, slots=True)
class CaptureConfig:
    """[capture]: cameras and capture loop.

    primary, assistant: `driver:address` of the camera whose path is the trajectory, and of the
    second one, as listed by `calm-edge cameras`; `v4l2:` takes the first and the second by USB
    port.
    rate_hz: frames a second, requested of the cameras.
    width_px, height_px: size of the pictures, requested; a camera may choose its nearest mode.
    stale_after_ms: time without a frame after which a camera is stale.
    realtime_priority: SCHED_FIFO priority of the capture threads, 1 to 99; 0: normal scheduling.
    exposure_us, gain, white_balance_k, focus: a number, `auto`, `auto-then-lock` (after two
    seconds) or `lock` (at the current value); microseconds, kelvin, otherwise the unit of the
    driver. A camera focuses by itself only with focus `auto`.
    readout_ms: time from the exposure of the first row to that of the last, 0 for a global shutter,
    one value or one per camera: a hint, it is learned from driving.
    mask: image file of each camera, black where its picture shows no scene, such as the bonnet; ""
    to learn it.
    mask_cells: the masks as `record` read them from these files; not for writing by hand.
    """

    primary: str = "v4l2:"
    assistant: str = "v4l2:"
    rate_hz: float = 20.0
    width_px: int = 1280
    height_px: int = 720
    stale_after_ms: float = 500.0
    realtime_priority: int = 0
    exposure_us: int | str = "auto"
    gain: int | str = "auto"
    white_balance_k: int | str = "auto"
    focus: int | str = "lock"
    readout_ms: tuple[float, ...] = ()
    mask: tuple[str, ...] = ()
    mask_cells: tuple[str, ...] = ()

    @property
    def readout_s_of_eye(self) -> tuple[float | None, float | None]:
        """Readout times of (primary, assistant) in seconds, None: unknown."""
        ms = self.readout_ms
        return (ms[0] / 1e3, ms[-1] / 1e3) if ms else (None, None)


@dataclass(frozen=True, slots=True)
class RecordingConfig:
    """[recording]: files of a recording.

    segment_s: length of a file in seconds. A power cut loses at most two seconds of it.
    chunk_bytes: size of the parts of a file that can be read by themselves.
    flush_s: time between writes to the disk.
    jpeg_quality: of pictures that a camera does not send as JPEG, 1 to 100.
    log_depth: compute and record the depth of sub-maps while driving.
    keep_free_gib, keep_free_percent: disk space to leave free, the larger of the two. Then the
    oldest drives are removed, or recording stops and poses continue.
    remove_old: with `record --root`, remove the oldest drives that are not marked by `calm-edge
    keep` before recording stops.
    """

    segment_s: float = 300.0
    chunk_bytes: int = 1 << 20
    flush_s: float = 0.5
    jpeg_quality: int = JPEG_QUALITY
    log_depth: bool = False
    keep_free_gib: float = 1.0
    keep_free_percent: float = 2.0
    remove_old: bool = True


@dataclass(frozen=True, slots=True)
class DegradeConfig:
    """[degrade]: reduction of work when the computer is hot or behind.

    The steps are: no depth, half the keyframes, no windows. A step is added when the temperature is
    too high, too many windows wait, or windows are dropped; it is taken back after a longer time
    below cool_c with at most one window waiting. Frames are always recorded.

    hot_c: temperature in degrees Celsius above which a step is added.
    cool_c: temperature below which a step is taken back.
    behind_windows: number of waiting windows above which a step is added.
    step_s: seconds from one step to the next.
    thermal_root: folder of the kernel's thermal zones.
    """

    hot_c: float = 85.0
    cool_c: float = 75.0
    behind_windows: int = 4
    step_s: float = 10.0
    thermal_root: str = "/sys/class/thermal"


@dataclass(frozen=True, slots=True)
class FrontendConfig:
    """[frontend]: keyframes, windows and the live tracker (paper IV-A, Implementation Details).

    flow_px: mean optical flow from one keyframe to the next, in px of an image whose long side has
    flow_reference_width_px.
    flow_reference_width_px: the width that flow_px is given for.
    max_keyframe_gap_s: longest time between keyframes while moving.
    n_max: number of primary keyframes in a window, except in the first.
    n_overlap: number of these that are the last ones of the previous window.
    first_window: number of keyframes in the first window, at most n_max; small, for an early first
    pose. The second window contains them again.
    max_pair_gap_s: largest time between a primary keyframe and the assistant frame chosen for it.
    tracker_points: most points tracked for the live pose.
    standstill_px: median flow between frames below which the car counts as standing.
    lost_after_ms: time without a new pose after which the live pose is lost.
    """

    flow_px: float = 25.0
    flow_reference_width_px: int = 1241
    max_keyframe_gap_s: float = 0.3
    n_max: int = 15
    n_overlap: int = 3
    first_window: int = 6
    max_pair_gap_s: float = 0.5
    tracker_points: int = 300
    standstill_px: float = 0.3
    lost_after_ms: float = 300.0


@dataclass(frozen=True, slots=True)
class BackboneConfig:
    """[backbone]: reconstruction of windows (paper III).

    name: `bundle:NAME_OR_FOLDER` (bundle adjustment with matches of that model), `bundle` (without
    a model), `scripted:FOLDER`, or a model alone: `feedforward:NAME_OR_FOLDER` or NAME.
    precision: of the model's graphs; auto: the best found by `calm-edge model check`, fp32 in
    lockstep.
    max_views: views per run of a feedforward model, at least 2; 0: as found by `model check`.
    hfov_deg: horizontal field of view, one for both cameras or one each; empty: unknown.
    seed: of the random draws, such as those of RANSAC.
    resolve_windows: number of recent windows that are solved again once the kit is better known.
    overlap_prior: a window takes over what the previous one says of their common keyframes; if off,
    each is solved alone as in the paper.
    kit_file: stores the calibration of these cameras for the next drive; empty: none.
    depth_side_px: longer side of the depth maps that bundle computes.
    depth_every: bundle computes the depth of every n-th view of each camera.
    reject_moving: bundle drops the depth of what moves by itself, such as other cars.
    """

    name: str = "bundle:calm-geo"
    precision: Literal["auto", "fp32", "fp16", "int8"] = "auto"
    max_views: int = 0
    hfov_deg: tuple[float, ...] = ()
    seed: int = 0
    resolve_windows: int = 400
    overlap_prior: bool = True
    kit_file: str = ""
    depth_side_px: int = 192
    depth_every: int = 1
    reject_moving: bool = True

    @property
    def hfov_of_eye(self) -> tuple[float | None, float | None]:
        """hfov_deg of (primary, assistant); a single value applies to both, None: unknown."""
        return (self.hfov_deg[0], self.hfov_deg[-1]) if self.hfov_deg else (None, None)


@dataclass(frozen=True, slots=True)
class CalibratedCameraConfig:
    """A calibrated camera: entries of geometry.camera.Camera, for pictures of its size.

    fit_px: its largest difference [px] to the lens model of the file that it was read from.
    """

    model: Literal["perspective", "fisheye"]
    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = ()
    fit_px: float = 0.0


@dataclass(frozen=True, slots=True)
class CalibrationConfig:
    """[calibration]: a known calibration, a prior on the kit.

    file: calibration of OpenCV, ROS, Kalibr or COLMAP, with both cameras, the primary first, or one
    file each.
    sigma_px: sigma of the calibration, rms over the picture.
    cameras: the cameras as `record` read them from the files; not for writing by hand.
    rig: rotation vector [rad] and centre [spacings] of the assistant in the primary camera, as read
    from the files; empty if they have none.
    """

    file: tuple[str, ...] = ()
    sigma_px: float = 1.0
    cameras: tuple[CalibratedCameraConfig, ...] = ()
    rig: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class ScaleConfig:
    """[scale]: scale of sub-maps (paper IV-B).

    spacing_m: metres between the optical centres; 0: the world unit is the spacing.
    average_placement: place a sub-map by all common frames; if off, by the first alone as in the
    paper.
    rectify: if off, every sub-map takes the scale factor of the first one (ablation).
    """

    spacing_m: float = 0.0
    average_placement: bool = False
    rectify: bool = True

    @property
    def spacing(self) -> float:
        """World units per map unit: spacing_m, or 1 if the world unit is the spacing."""
        return self.spacing_m or 1.0


@dataclass(frozen=True, slots=True)
class CorrectionConfig:
    """[correction]: correction of intrinsics and poses (paper V; extensions of it are marked).

    Focal lengths are searched that fit the fundamental matrices F of many image pairs. Pairs of one
    sub-map form a group, and the groups of a camera its bank.

    apply: `auto` (if the backbone does not estimate the kit itself), always, never.
    matches: `auto` (the backbone's if it provides them, else SIFT) or `sift`.
    weighted: (extension) weight each F by its information.
    refine: (extension) minimise the score over the bank; if off, search among the backbone's
    guesses by the unweighted mean.
    rotation, translation: correct the rotations, the translations of the poses.
    general_translation: correct translations for any rotation between two views; if off, by the
    paper's simpler formula for small ones.
    rigid_rig: (extension) remove a constant rotation rate of the assistant relative to the primary.
    adaptive_damping: correct a focal by a share that grows with the bank; if off, in full from the
    first estimate on.
    group_every: sub-maps from one group of image pairs to the next.
    n_pair: least number of F in a group.
    n_feature: least number of inliers of an F.
    n_group: most groups in the bank of a camera.
    max_features: most SIFT features per image.
    """

    apply: Literal["auto", "always", "never"] = "auto"
    matches: Literal["auto", "sift"] = "auto"
    weighted: bool = True
    refine: bool = True
    rotation: bool = True
    translation: bool = True
    general_translation: bool = False
    rigid_rig: bool = True
    adaptive_damping: bool = True
    group_every: int = 5
    n_pair: int = 10
    n_feature: int = 10
    n_group: int = 5
    max_features: int = 500


@dataclass(frozen=True, slots=True)
class LoopConfig:
    """[loops]: loop closure (paper IV-D).

    enabled: if off, places are not recognised and no loop is closed.
    min_gap: least number of keyframes between two visits to a place.
    top_k: candidates per query.
    max_places: most places kept to search in.
    min_matches: epipolar inliers that two images of one place must have.
    descriptor: of places: `learned` (by the backbone's network), `gradients`, or `auto` (learned if
    there is a network).
    """

    enabled: bool = True
    min_gap: int = 60
    top_k: int = 3
    max_places: int = 1000
    min_matches: int = 30
    descriptor: Literal["auto", "gradients", "learned"] = "auto"


@dataclass(frozen=True, slots=True)
class PoseGraphConfig:
    """[posegraph]: joint pose graph optimisation (paper IV-C).

    optimise: if off, poses are not optimised.
    window: each keyframe has edges to this many earlier ones of its sub-map.
    rotation_variance, translation_variance: of such an edge, in rad² and map units².
    rig_prior_variance: of the prior on the rig T_p_a, whose mean is the rig of the first sub-map;
    of rotation and translation alike, in the same units.
    """

    optimise: bool = True
    window: int = 3
    rotation_variance: float = 0.05
    translation_variance: float = 0.1
    rig_prior_variance: float = 0.01


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """[mapping]: dense map (paper VI).

    Anchors, points seen in several views, join the sub-maps. suppress, distance_weight and deform
    can be switched off for ablations. suppression_radius, max_range and cloud_voxel are in map
    units, that is in spacings.

    suppress: use only anchors without a neighbour within suppression_radius that more sub-maps
    observe.
    distance_weight: average an anchor's positions of several sub-maps with the weight 1 / distance²
    to the sub-map's central camera.
    deform: bend each sub-map so that its anchors meet these averages.
    grid: at most one new anchor is taken from each of grid x grid cells of an image.
    depth_tolerance: a view sees an anchor if the view's depth there differs from the anchor's by at
    most this share.
    min_confidence: pixels with a lower confidence are not used.
    suppression_radius: distance within which anchors are neighbours.
    stiffness: resistance of a sub-map to bending, 0: none.
    max_control_points: most anchors that bend one sub-map.
    max_points_per_submap: most points that one sub-map adds to the cloud.
    max_range: pixels with a larger z-depth are not used.
    cloud_voxel: edge of a voxel, in which one point is kept (0.1 m for cameras half a metre apart).
    """

    suppress: bool = True
    distance_weight: bool = True
    deform: bool = True

    grid: int = 24
    depth_tolerance: float = 0.02
    min_confidence: float = 0.5
    suppression_radius: float = 0.75
    stiffness: float = 1e-4
    max_control_points: int = 150
    max_points_per_submap: int = 300_000
    max_range: float = 60.0
    cloud_voxel: float = 0.2


@dataclass(frozen=True, slots=True)
class PoseOutputConfig:
    """[pose_output]: output of poses as MAVLink 2 ODOMETRY.

    port: a serial device or `udp:HOST:PORT`; empty: none.
    baud: rate of the serial port, bits a second.
    rate_hz: highest rate of poses; there is one pose per frame.
    system_id: MAVLink system id of the autopilot.
    mounting_rpy_deg, mounting_xyz_m: mounting T_b_c of the primary camera in the body (forward,
    right, down): roll, pitch, yaw, and position.
    """

    port: str = ""
    baud: int = 115_200
    rate_hz: float = 30.0
    system_id: int = 1
    mounting_rpy_deg: tuple[float, ...] = (0.0, 0.0, 0.0)
    mounting_xyz_m: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class GpsConfig:
    """[gps]: GPS fixes to record.

    source: a serial device that sends NMEA at `baud`, `gpsd`, `gpsd:HOST:PORT`, or, of a replay, a
    file (GPX, NMEA); empty: none.
    baud: rate of the serial device, bits a second.
    """

    source: str = ""
    baud: int = 9600


@dataclass(frozen=True, slots=True)
class LiveConfig:
    """[live]: results for the page of `calm-edge live`, which is a process of its own.

    socket: path of a Unix socket at which the recording offers them; empty: none. `record --live`
    chooses one.
    """

    socket: str = ""


@dataclass(frozen=True, slots=True)
class Config:
    """All sections of the configuration."""

    capture: CaptureConfig = field(default_factory=CaptureConfig)
    recording: RecordingConfig = field(default_factory=RecordingConfig)
    degrade: DegradeConfig = field(default_factory=DegradeConfig)
    frontend: FrontendConfig = field(default_factory=FrontendConfig)
    backbone: BackboneConfig = field(default_factory=BackboneConfig)
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    correction: CorrectionConfig = field(default_factory=CorrectionConfig)
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    posegraph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    mapping: MappingConfig = field(default_factory=MappingConfig)
    pose_output: PoseOutputConfig = field(default_factory=PoseOutputConfig)
    gps: GpsConfig = field(default_factory=GpsConfig)
    live: LiveConfig = field(default_factory=LiveConfig)

    @property
    def overlap_shared(self) -> int:
        """Last primary keyframes of a window of which the next one takes over poses; 0: none."""
        return self.frontend.n_overlap if self.backbone.overlap_prior else 0

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Convert to a nested dict, as stored in the metadata of recordings."""
        return dataclasses.asdict(self)


class ConfigError(CalmEdgeError):
    """A key is unknown or a value is invalid."""


def merge(config: Config, changes: dict[str, Any]) -> Config:
    """Apply nested `changes` to a config; raises ConfigError on unknown keys or wrong types."""
    sections = {f.name: getattr(config, f.name) for f in dataclasses.fields(Config)}
    for section, values in changes.items():
        if section not in sections:
            hint = similar([section], list(sections))
            raise ConfigError(f"{section}: no such section{hint}; known: {', '.join(sections)}")
        if not isinstance(values, dict):
            raise ConfigError(f"{section}: expected a table of keys")
        kinds = get_type_hints(type(sections[section]))
        for key, value in values.items():
            if key not in kinds:
                hint = similar([key], list(kinds))
                raise ConfigError(f"{section}.{key}: no such key{hint}; known: {', '.join(kinds)}")
            value = coerce(f"{section}.{key}", kinds[key], value, ConfigError)
            sections[section] = dataclasses.replace(sections[section], **{key: value})
    return Config(**sections)


def parse_assignment(text: str) -> dict[str, Any]:
    """Parse `section.key=value` (a TOML value or a bare word) to a nested dict; ConfigError."""
    name, equals, value = text.partition("=")
    section, dot, key = name.strip().partition(".")
    if not (equals and dot and key):
        raise ConfigError(f"--set {text}: expected section.key=value")
    try:
        parsed: Any = tomllib.loads(f"v = {value}")["v"]
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = value.strip()
    return {section: {key: parsed}}


def load(
    path: Path | None, assignments: list[str] | None = None, base: Config | None = None
) -> Config:
    """Combine `base`, the TOML file and `section.key=value` assignments, in this order.

    base: the defaults if None. Raises ConfigError.
    """
    config = base or Config()
    if path is not None:
        try:
            # editors on other systems begin a file with a byte order mark
            config = merge(config, tomllib.loads(path.read_text("utf-8-sig")))
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
        except UnicodeDecodeError:
            raise ConfigError(f"{path}: not UTF-8 text; save it as UTF-8") from None
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            raise ConfigError(f"{path}: not valid TOML: {error}") from None
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
    for text in assignments or []:
        config = merge(config, parse_assignment(text))
    return config
