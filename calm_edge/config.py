"""One typed section a folder; the defaults are the paper's values where it gives them."""

from __future__ import annotations

import dataclasses
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_type_hints

from calm_edge.typed import coerce
from calm_edge.types import CalmEdgeError
from device.frame import JPEG_QUALITY


@dataclass(frozen=True, slots=True)
class CaptureConfig:
    """device/ and the fixed-rate loop. primary / assistant: `driver:address`.

    realtime_priority: SCHED_FIFO of the capture threads, 1 to 99; 0 leaves them ordinary.
    exposure_us, gain, white_balance_k, focus: a number, `auto`, `auto-then-lock` (after two
    seconds) or `lock` (as it stands): device/camera, CameraControls. Autofocus only by `auto`.
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


@dataclass(frozen=True, slots=True)
class RecordingConfig:
    """keep_free_gib, keep_free_percent: the larger of the two stays free on the disk.

    remove_old: under `record --root`, the oldest drives not kept make room before recording stops.
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
    """Work is shed in the order depth, half the keyframes, all windows; frames never.

    hot_c: from here on, or with more than behind_windows waiting or some given up for newer ones, a
    step each step_s; back below cool_c and caught up. thermal_root: the kernel's thermal zones.
    """

    hot_c: float = 85.0
    cool_c: float = 75.0
    behind_windows: int = 4
    step_s: float = 10.0
    thermal_root: str = "/sys/class/thermal"


@dataclass(frozen=True, slots=True)
class FrontendConfig:
    """Paper IV-A and its implementation details.

    first_window: keyframes of the first window, at most n_max, so that there is a pose soon; the
    second one holds them all again.
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
    """name: `bundle:NAME_OR_FOLDER`, matching by that model; `bundle`, without one;
    `scripted:FOLDER`; or a model alone: `feedforward:NAME_OR_FOLDER`, or its NAME.

    precision: of a model's graphs; auto is what `model check` found best here, fp32 in lockstep.
    max_views: a run of a feedforward model, at least 2; 0 is what `model check` found.
    resolve_windows: how many recent windows can be solved again when the kit is known better.
    kit_file: where what a drive learns of these cameras is kept for the next one; empty for none.
    """

    name: str = "bundle:calm-geo"
    precision: Literal["auto", "fp32", "fp16", "int8"] = "auto"
    max_views: int = 0
    hfov_deg: tuple[float, ...] = ()
    seed: int = 0
    resolve_windows: int = 400
    kit_file: str = ""

    @property
    def hfov_of_eye(self) -> tuple[float | None, float | None]:
        """hfov_deg of the primary and the assistant: one value serves both, none is unknown."""
        return (self.hfov_deg[0], self.hfov_deg[-1]) if self.hfov_deg else (None, None)


@dataclass(frozen=True, slots=True)
class ScaleConfig:
    """spacing_m: metres between the optical centres; 0 leaves the world in spacings.

    average_placement: place by all common frames instead of the paper's first one.
    rectify: off, every sub-map takes the factor of the first one placed, as that now is (ablation).
    """

    spacing_m: float = 0.0
    average_placement: bool = False
    rectify: bool = True

    @property
    def spacing(self) -> float:
        """World units a map unit: spacing_m, or 1 where the world is in spacings."""
        return self.spacing_m or 1.0


@dataclass(frozen=True, slots=True)
class CorrectionConfig:
    """Paper V. apply: `auto` (where the backbone does not learn the kit itself), always, never.

    matches: `auto` (the backbone's own where it gives any, else SIFT) or `sift`.
    weighted, refine: past the paper; each F weighs what it can tell, and the score is minimised
    on the bank; off, the search chooses among the backbone's guesses by the plain mean.
    rotation, translation: the two halves of the pose correction. general_translation: the skew
    part of M; off, the simplified t = S t_est. adaptive_damping: off, K_global
    is trusted wholly (damping 1) as soon as there is one.
    rigid_rig: an even turn of the assistant against the primary is taken out (past the paper).
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
    """Paper IV-D. min_gap: keyframes between a place and its return. max_places: remembered.

    descriptor: `auto` (the network's of the backbone where it has one, else gradients), or either.
    """

    enabled: bool = True
    min_gap: int = 60
    top_k: int = 3
    max_places: int = 1000
    min_matches: int = 30
    descriptor: Literal["auto", "gradients", "learned"] = "auto"


@dataclass(frozen=True, slots=True)
class PoseGraphConfig:
    """Paper IV-C: variances, in map units and radians. optimise: off, poses stay as placed."""

    optimise: bool = True
    window: int = 3
    rotation_variance: float = 0.05
    translation_variance: float = 0.1
    rig_prior_variance: float = 0.01


@dataclass(frozen=True, slots=True)
class MappingConfig:
    """Paper VI. suppression_radius, max_range, cloud_voxel: map units (spacings).

    max_range: z-depth beyond which a pixel is neither anchor nor point.
    cloud_voxel: the cloud keeps one point a voxel (0.1 m for cameras half a metre apart).
    suppress, distance_weight, deform: the parts of VI-C and VI-D, each off for an ablation.
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
    """port: a serial device, empty for none. rate_hz: at most; no pose is sent twice.

    mounting_rpy_deg, mounting_xyz_m: body(FRD)<-primary camera. system_id: the autopilot's own.
    """

    port: str = ""
    baud: int = 115_200
    rate_hz: float = 30.0
    system_id: int = 1
    mounting_rpy_deg: tuple[float, ...] = (0.0, 0.0, 0.0)
    mounting_xyz_m: tuple[float, ...] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Config:
    capture: CaptureConfig = field(default_factory=CaptureConfig)
    recording: RecordingConfig = field(default_factory=RecordingConfig)
    degrade: DegradeConfig = field(default_factory=DegradeConfig)
    frontend: FrontendConfig = field(default_factory=FrontendConfig)
    backbone: BackboneConfig = field(default_factory=BackboneConfig)
    correction: CorrectionConfig = field(default_factory=CorrectionConfig)
    scale: ScaleConfig = field(default_factory=ScaleConfig)
    loops: LoopConfig = field(default_factory=LoopConfig)
    posegraph: PoseGraphConfig = field(default_factory=PoseGraphConfig)
    mapping: MappingConfig = field(default_factory=MappingConfig)
    pose_output: PoseOutputConfig = field(default_factory=PoseOutputConfig)

    def to_dict(self) -> dict[str, dict[str, Any]]:
        """Plain nested dict: what goes into every recording's metadata."""
        return dataclasses.asdict(self)


class ConfigError(CalmEdgeError):
    """An unknown key or a value of the wrong kind."""


def merge(config: Config, changes: dict[str, Any]) -> Config:
    """A config with nested `changes` applied; raises ConfigError on unknown keys or kinds."""
    sections = {f.name: getattr(config, f.name) for f in dataclasses.fields(Config)}
    for section, values in changes.items():
        if section not in sections:
            raise ConfigError(f"{section}: no such section; known: {', '.join(sections)}")
        if not isinstance(values, dict):
            raise ConfigError(f"{section}: expected a table of keys")
        kinds = get_type_hints(type(sections[section]))
        for key, value in values.items():
            if key not in kinds:
                raise ConfigError(f"{section}.{key}: no such key; known: {', '.join(kinds)}")
            value = coerce(f"{section}.{key}", kinds[key], value, ConfigError)
            sections[section] = dataclasses.replace(sections[section], **{key: value})
    return Config(**sections)


def parse_assignment(text: str) -> dict[str, Any]:
    """`section.key=value` (a TOML value, or a bare word) -> nested dict; raises ConfigError."""
    name, equals, value = text.partition("=")
    section, dot, key = name.strip().partition(".")
    if not (equals and dot and key):
        raise ConfigError(f"--set {text}: expected section.key=value")
    try:
        parsed: Any = tomllib.loads(f"v = {value}")["v"]
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = value.strip()
    return {section: {key: parsed}}


def load(path: Path | None, assignments: list[str] | None = None) -> Config:
    """Defaults, then the TOML file, then `section.key=value` assignments; raises ConfigError."""
    config = Config()
    if path is not None:
        try:
            config = merge(config, tomllib.loads(path.read_text()))
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read ({error.strerror})") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise ConfigError(f"{path}: not valid TOML: {error}") from None
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from None
    for text in assignments or []:
        config = merge(config, parse_assignment(text))
    return config
