"""Golden values: reference inputs and outputs of a model's graphs, and deviation from them."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from calm_edge.backbones.onnx.manifest import Manifest, ManifestError
from calm_edge.backbones.onnx.picture_input import Fit, fit_pictures, input_tensor
from calm_edge.backbones.onnx.session import Tensor
from calm_edge.types import Bytes

PICTURES = "pictures"


@dataclass(frozen=True, slots=True)
class Case:
    """A reference run. inputs, outputs: tensors by name, of the original model.

    pictures: (N, H, W, 3) uint8 BGR images from which the input was made, or None.
    """

    role: str
    name: str
    inputs: dict[str, Tensor] = field(default_factory=dict)
    outputs: dict[str, Tensor] = field(default_factory=dict)
    pictures: Bytes | None = None

    def shapes(self) -> tuple[tuple[int, ...], ...]:
        """Shapes of all inputs, sorted by name."""
        return tuple(self.inputs[name].shape for name in sorted(self.inputs))


def read_cases(manifest: Manifest) -> list[Case]:
    """Read all cases of `golden.npz`. Raises ManifestError.

    Each role needs cases of two different shapes, or one if the number of views is fixed: a graph
    traced at one number of views can run at another and give wrong results.
    """
    path = manifest.folder / manifest.golden.file
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise ManifestError(f"{path}: cannot be read ({error})") from None
    parts: dict[tuple[str, str], dict[str, Tensor]] = {}
    for name, array in arrays.items():
        role, _, rest = name.partition("/")
        case, _, what = rest.partition("/")
        if role not in manifest.graphs or not what:
            raise ManifestError(f"{path}: {name}: expected ROLE/CASE/(pictures | in/X | out/X)")
        parts.setdefault((role, case), {})[what] = array
    cases = [_case(manifest, role, case, part) for (role, case), part in parts.items()]
    for role in manifest.graphs:
        shapes = {case.shapes() for case in cases if case.role == role}
        if len(shapes) < (2 if manifest.frames.dynamic else 1):
            raise ManifestError(
                f"{path}: {role}: {len(shapes)} cases of different shapes; golden values at two "
                "or more numbers of views are needed"
            )
    return cases


def fits_of(manifest: Manifest, case: Case) -> list[Fit]:
    """Placement of a case's images in the input; the whole input if the case has no images."""
    if case.pictures is not None:
        return _fits_of_pictures(manifest, case.pictures)
    layout, shape = manifest.input.layout, case.inputs[manifest.input.name].shape
    if len(shape) != len(layout):
        raise ManifestError(f"golden values: {case.name}: {shape} is not {layout}")
    n, height, width = (shape[layout.index(axis)] for axis in "NHW")
    return [Fit((width, height), (width, height), (0, 0), (width, height))] * n


def _fits_of_pictures(manifest: Manifest, pictures: Bytes) -> list[Fit]:
    n, height, width = pictures.shape[:3]
    return fit_pictures(manifest.input, [(width, height)] * n)


def deviation(found: Tensor, expected: Tensor) -> float:
    """RMS error of the worst slice (usually view) relative to the RMS of the whole tensor.

    Slices are along the first axis longer than one, so that a single wrong view is noticed. inf
    if the shapes differ or a number is not finite.
    """
    if found.shape != expected.shape or not np.isfinite(found).all():
        return float("inf")
    axis = next((i for i, size in enumerate(found.shape) if size > 1), None)
    if axis is None:
        rows = np.atleast_2d(found.astype(np.float64) - expected).reshape(1, -1)
    else:
        difference = found.astype(np.float64) - expected
        rows = np.moveaxis(difference, axis, 0).reshape(found.shape[axis], -1)
    worst = float(np.sqrt((rows**2).mean(1).max())) if rows.size else 0.0
    level = float(np.sqrt((expected.astype(np.float64) ** 2).mean())) if expected.size else 0.0
    return worst / level if level > 0 else worst


def _case(manifest: Manifest, role: str, name: str, part: Mapping[str, Tensor]) -> Case:
    where = f"{manifest.folder / manifest.golden.file}: {role}/{name}"
    case = Case(role, name)
    pictures = None
    for what, array in part.items():
        kind, _, tensor = what.partition("/")
        if what == PICTURES:
            pictures = _pictures(manifest, where, array)
            case.inputs[manifest.input.name] = input_tensor(
                manifest.input, list(pictures), _fits_of_pictures(manifest, pictures)
            )
        elif kind in ("in", "out") and tensor:
            (case.inputs if kind == "in" else case.outputs)[tensor] = array
        else:
            raise ManifestError(f"{where}/{what}: expected pictures, in/X or out/X")
    if not case.inputs or not case.outputs:
        raise ManifestError(f"{where}: has no input or no output")
    return Case(role, name, case.inputs, case.outputs, pictures)


def _pictures(manifest: Manifest, where: str, array: Tensor) -> Bytes:
    if array.dtype != np.uint8 or array.ndim != 4 or array.shape[3] != 3 or not array.size:
        raise ManifestError(f"{where}/{PICTURES}: expected (N, H, W, 3) uint8, got {array.shape}")
    size = (array.shape[2], array.shape[1])
    wanted = _fits_of_pictures(manifest, array)[0].input
    if size != wanted:
        raise ManifestError(
            f"{where}/{PICTURES}: {size[0]}x{size[1]} px, but the input of such pictures is "
            f"{wanted[0]}x{wanted[1]}: golden pictures must have the size of the input"
        )
    return array
