"""Data classes of a model folder's `manifest.toml`, one per table of the file.

`models/README.md` documents the keys; `model_folder.py` reads and checks the file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from calm_edge.backbones.base import BackboneError

FORMAT = 1

Kind = Literal["feedforward", "bundle"]
Precision = Literal["fp32", "fp16", "int8"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)
ROLES: dict[str, tuple[str, ...]] = {
    "feedforward": ("model",),
    "bundle": ("encoder", "refine", "depth"),
}


class ManifestError(BackboneError):
    """A model folder is incomplete, damaged, or its manifest is inconsistent."""


@dataclass(frozen=True, slots=True)
class GraphFile:
    """An .onnx file and its sha256. external: sha256 of its external weight files, by name."""

    file: str
    sha256: str
    external: dict[str, str] = field(default_factory=dict)

    def files(self) -> dict[str, str]:
        """sha256 of all files of the graph, by name."""
        return {self.file: self.sha256, **self.external}


@dataclass(frozen=True, slots=True)
class Graph:
    """The graph of a role in up to three precisions, all with the same inputs and outputs.

    inputs, outputs: names of tensors that the graph must have; empty: not checked.
    """

    fp32: GraphFile | None = None
    fp16: GraphFile | None = None
    int8: GraphFile | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def variants(self) -> dict[Precision, GraphFile]:
        """Graph files by precision, for the precisions present."""
        each: dict[Precision, GraphFile | None] = {
            "fp32": self.fp32,
            "fp16": self.fp16,
            "int8": self.int8,
        }
        return {precision: graph for precision, graph in each.items() if graph is not None}


@dataclass(frozen=True, slots=True)
class InputSpec:
    """Preprocessing of images to the input tensor (`picture_input.py`).

    Channel values are (v / 255 - mean) / std. size_px: target of resize `width` or `longest`.
    height_px: fixed height, 0 to keep the aspect ratio. pad_value: in [0, 1], before mean and std.
    """

    name: str
    layout: Literal["NCHW", "NHWC", "BNCHW", "BNHWC"]
    channels: Literal["rgb", "bgr", "gray"]
    resize: Literal["width", "longest", "keep"]
    mean: tuple[float, ...] = (0.0,)
    std: tuple[float, ...] = (1.0,)
    size_px: int = 0
    height_px: int = 0
    multiple: int = 1
    multiple_by: Literal["stretch", "crop", "pad"] = "stretch"
    common_by: Literal["crop", "pad"] = "pad"
    pad_value: float = 0.0
    interpolation: Literal["area", "bilinear", "bicubic"] = "area"


@dataclass(frozen=True, slots=True)
class FrameRange:
    """Number of views per run: any in [min, max] if dynamic, else exactly max (= min)."""

    min: int
    max: int
    dynamic: bool


@dataclass(frozen=True, slots=True)
class PoseOutput:
    """Encoding of the pose output. direction: camera to world, or world to camera.

    quaternion: component order of `t_quat`. rotation: of matrices; `nearest` if the network gives
    an arbitrary 3x3 matrix that must be projected to the nearest rotation.
    """

    name: str
    encoding: Literal["t_quatxyzw_fovhw", "mat3x4", "mat4x4", "t_quat"]
    direction: Literal["world_to_camera", "camera_to_world"]
    quaternion: Literal["xyzw", "wxyz"] = "xyzw"
    rotation: Literal["exact", "nearest"] = "exact"


@dataclass(frozen=True, slots=True)
class IntrinsicsOutput:
    """Encoding of the intrinsics. name: output tensor for the encodings `pixels` and `fov`.

    It is empty for a `fov` that is part of the pose output. pixel_origin: of `pixels`: (0, 0) is
    the corner or the centre of the first pixel. principal_point: of `solved` (fitted to rays or
    points): free, or fixed at the image centre.
    """

    encoding: Literal["fov", "pixels", "solved"]
    name: str = ""
    pixel_origin: Literal["corner", "centre"] = "corner"
    principal_point: Literal["free", "centre"] = "free"


@dataclass(frozen=True, slots=True)
class GeometryOutput:
    """Encoding of depth. rays: output tensor with the ray directions of the encoding `ray_depth`.

    If it is empty, the ray directions follow from the intrinsics.
    """

    name: str
    encoding: Literal["z_depth", "point_map", "ray_depth"]
    rays: str = ""


@dataclass(frozen=True, slots=True)
class ConfidenceOutput:
    """Encoding of the confidence; expp1 is 1 + exp(x)."""

    name: str
    encoding: Literal["expp1", "logit", "raw"]


@dataclass(frozen=True, slots=True)
class Outputs:
    """Meaning of the output tensors. confidence: None if the model has none; all depth is equal."""

    pose: PoseOutput
    intrinsics: IntrinsicsOutput
    geometry: GeometryOutput
    confidence: ConfidenceOutput | None = None

    def names(self) -> tuple[str, ...]:
        """Names of all output tensors used in decoding, without duplicates."""
        named = [self.pose.name, self.intrinsics.name, self.geometry.name, self.geometry.rays]
        named += [self.confidence.name] if self.confidence else []
        return tuple(dict.fromkeys(n for n in named if n))


@dataclass(frozen=True, slots=True)
class Golden:
    """Reference inputs and outputs (`golden.py`) and tolerances per precision, relative RMS.

    scene: the images show one static scene, so that depth must agree between views.
    """

    sha256: str
    file: str = "golden.npz"
    fp32: float = 1e-3
    fp16: float = 2e-2
    int8: float = 0.15
    scene: bool = True

    def tolerance(self, precision: Precision) -> float:
        """Largest accepted relative RMS error of a precision."""
        return {"fp32": self.fp32, "fp16": self.fp16, "int8": self.int8}[precision]


@dataclass(frozen=True, slots=True)
class Manifest:
    """A model's manifest. folder and digest (sha256 of the file) are set on reading, not keys.

    unmeasured: default precision on a machine where `model check` has not run; empty: fp32 with
    a notice.
    """

    format: int
    name: str
    kind: Kind
    license: str
    graphs: dict[str, Graph]
    input: InputSpec
    frames: FrameRange
    golden: Golden
    source: str = ""
    unmeasured: Literal["", "fp32", "fp16", "int8"] = ""
    output: Outputs | None = None
    folder: Path = Path()
    digest: str = ""

    def precisions(self) -> tuple[Precision, ...]:
        """Precisions in which all graphs are present."""
        each = [graph.variants() for graph in self.graphs.values()]
        return tuple(p for p in PRECISIONS if all(p in variants for variants in each))

    def graph_path(self, role: str, precision: Precision) -> Path:
        """Path of a role's .onnx file. Raises ManifestError if it has no such precision."""
        variants = self.graphs[role].variants() if role in self.graphs else {}
        if precision not in variants:
            have = ", ".join(variants) or "none"
            raise ManifestError(f"{self.name}: {role} has no {precision} graph; it has: {have}")
        return self.folder / variants[precision].file
