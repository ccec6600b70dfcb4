"""The keys of a model folder's `manifest.toml`.

`models/README.md` explains each of them; `model_folder.py` reads and checks them.
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
    """A model folder that is incomplete, damaged, or says what makes no sense."""


@dataclass(frozen=True, slots=True)
class GraphFile:
    """One .onnx file; external: weight files beside it that it names -> their sha256."""

    file: str
    sha256: str
    external: dict[str, str] = field(default_factory=dict)

    def files(self) -> dict[str, str]:
        """Every file that has to be there -> its sha256."""
        return {self.file: self.sha256, **self.external}


@dataclass(frozen=True, slots=True)
class Graph:
    """One role's graph in up to three precisions; all take and give the same tensors.

    inputs, outputs: the tensors it must have; empty is not looked at.
    """

    fp32: GraphFile | None = None
    fp16: GraphFile | None = None
    int8: GraphFile | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def variants(self) -> dict[Precision, GraphFile]:
        """The precisions there are."""
        each: dict[Precision, GraphFile | None] = {
            "fp32": self.fp32,
            "fp16": self.fp16,
            "int8": self.int8,
        }
        return {precision: graph for precision, graph in each.items() if graph is not None}


@dataclass(frozen=True, slots=True)
class InputSpec:
    """How pictures become the input tensor (`picture_input.py`).

    The value of a channel is (v / 255 - mean) / std. size_px: of `width` or `longest`. height_px:
    fixed height, 0 for what the picture's shape gives. pad_value: in [0, 1], before mean and std.
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
    """Views a run: any number in [min, max] when dynamic, else exactly max (= min)."""

    min: int
    max: int
    dynamic: bool


@dataclass(frozen=True, slots=True)
class PoseOutput:
    """quaternion: component order, of `t_quat`. direction: what the numbers do to points.

    rotation: of matrices; nearest, if any 3x3 may come and the rotation nearest to it is meant.
    """

    name: str
    encoding: Literal["t_quatxyzw_fovhw", "mat3x4", "mat4x4", "t_quat"]
    direction: Literal["world_to_camera", "camera_to_world"]
    quaternion: Literal["xyzw", "wxyz"] = "xyzw"
    rotation: Literal["exact", "nearest"] = "exact"


@dataclass(frozen=True, slots=True)
class IntrinsicsOutput:
    """name: of `pixels`, and of `fov` unless the pose holds it. The rest is read by decoders.

    pixel_origin: of `pixels`; whether (0, 0) is the corner or the centre of the first pixel.
    principal_point: of `solved`; free, or held at the middle of the input.
    """

    encoding: Literal["fov", "pixels", "solved"]
    name: str = ""
    pixel_origin: Literal["corner", "centre"] = "corner"
    principal_point: Literal["free", "centre"] = "free"


@dataclass(frozen=True, slots=True)
class GeometryOutput:
    """rays: of `ray_depth`, the directions' output; without it they follow from K."""

    name: str
    encoding: Literal["z_depth", "point_map", "ray_depth"]
    rays: str = ""


@dataclass(frozen=True, slots=True)
class ConfidenceOutput:
    name: str
    encoding: Literal["expp1", "logit", "raw"]


@dataclass(frozen=True, slots=True)
class Outputs:
    """confidence: None for a model that has none: then all depth is believed alike."""

    pose: PoseOutput
    intrinsics: IntrinsicsOutput
    geometry: GeometryOutput
    confidence: ConfidenceOutput | None = None

    def names(self) -> tuple[str, ...]:
        """Every output tensor that decoding reads, once."""
        named = [self.pose.name, self.intrinsics.name, self.geometry.name, self.geometry.rays]
        named += [self.confidence.name] if self.confidence else []
        return tuple(dict.fromkeys(n for n in named if n))


@dataclass(frozen=True, slots=True)
class Golden:
    """Known inputs and outputs (`golden.py`), and how far a run may be off: relative RMS.

    scene: the pictures show one scene, so that depth of one view must fit the others.
    """

    sha256: str
    file: str = "golden.npz"
    fp32: float = 1e-3
    fp16: float = 2e-2
    int8: float = 0.15
    scene: bool = True

    def tolerance(self, precision: Precision) -> float:
        """The largest relative RMS error that is let pass."""
        return {"fp32": self.fp32, "fp16": self.fp16, "int8": self.int8}[precision]


@dataclass(frozen=True, slots=True)
class Manifest:
    """folder and digest (sha256 of the manifest) are not keys but where it was read.

    unmeasured: the precision to run where `model check` never ran, of a model whose maker knows;
    empty for fp32, which is said.
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
        """Those that every graph comes in."""
        each = [graph.variants() for graph in self.graphs.values()]
        return tuple(p for p in PRECISIONS if all(p in variants for variants in each))

    def graph_path(self, role: str, precision: Precision) -> Path:
        """Raises ManifestError when the graph does not come in that precision."""
        variants = self.graphs[role].variants() if role in self.graphs else {}
        if precision not in variants:
            have = ", ".join(variants) or "none"
            raise ManifestError(f"{self.name}: {role} has no {precision} graph; it has: {have}")
        return self.folder / variants[precision].file
