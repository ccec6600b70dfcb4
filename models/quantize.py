"""Add int8 (dynamic or static) and fp16 variants to an exported model; print their deviation.

    python models/quantize.py models/vggt --int8 dynamic
    python models/quantize.py models/vggt --int8 static --pictures drive/ --fp16

Only the layers that exchange information between views (VGGT's aggregator) are converted: heads
and camera branch lose too much accuracy. `calm-edge model check` decides whether a variant is
accurate enough and faster.
"""

from __future__ import annotations

import argparse
import ast
import copy
import sys
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime import InferenceSession, quantization
from onnxruntime.transformers import float16

sys.path.insert(0, str(Path(__file__).resolve().parent))
from exporting import folder, runtime
from exporting.pictures import normalised, pictures

# modules to convert, by the model's name in the manifest
PARTS = {
    "da3": ("net.backbone",),
    "vggt": ("net.aggregator",),
    "pi3": ("net.encoder", "net.decoder"),
    "mapanything": ("net.encoder", "net.info_sharing"),
}
SCOPES = "pkg.torch.onnx.name_scopes"
CALIBRATION_VIEWS = 4
WHOLE_BYTES = 1_500_000_000
INT8 = ["MatMul", "Gemm"]
MULTIPLY = {*INT8, "Conv", "ConvTranspose"}
# suffix of the names of casts that the fp16 conversion inserts after float nodes
HALVED = "_cast_to_fp16_node"
TIMED_RUNS = 5


class Calibration(quantization.CalibrationDataReader):
    """Data for static quantisation: one window of images per call."""

    def __init__(self, windows: list[NDArray[np.float32]]) -> None:
        self._windows: Iterator[NDArray[np.float32]] = iter(windows)

    def get_next(self) -> dict[str, NDArray[np.float32]] | None:
        """The next window, by the name of the input; None after the last."""
        window = next(self._windows, None)
        return None if window is None else {runtime.INPUT: window}


def main(argv: list[str] | None = None) -> None:
    """Exits with a message of one line on errors."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("model", type=Path, help="folder that export.py wrote")
    parser.add_argument("--int8", choices=("dynamic", "static"))
    parser.add_argument("--fp16", action="store_true", help="for GPUs; no faster on CPUs")
    parser.add_argument("--pictures", type=Path, help="folder of images for calibration")
    parser.add_argument("--windows", type=int, default=8, help="number of windows for calibration")
    parser.add_argument("--parts", nargs="+", help="modules to convert, instead of the default")
    args = parser.parse_args(argv)
    path = args.model / "model.onnx"
    if not path.is_file():
        raise SystemExit(f"{path}: missing; run export.py first")
    if args.int8 == "static" and not args.pictures:
        raise SystemExit("--pictures: missing; static int8 needs images for calibration")
    if not (args.int8 or args.fp16):
        raise SystemExit("nothing to do; give --int8 or --fp16")
    manifest = tomllib.loads((args.model / folder.MANIFEST).read_text())
    parts = args.parts or PARTS.get(manifest["name"])
    if not parts:
        raise SystemExit(f"--parts: missing; there is no default for {manifest['name']}")
    model = onnx.load(path)
    outside = _outside(model, tuple(parts))
    if args.fp16:
        to = args.model / "model.fp16.onnx"
        _fp16(model, to, outside)
        _report(args.model, "fp16", to, model, outside)
    if args.int8:
        windows = []
        if args.int8 == "static":
            windows = _windows(args.pictures, manifest["input"], args.windows)
        to = args.model / "model.int8.onnx"
        _int8(model, to, outside, windows)
        _report(args.model, "int8", to, model, outside)


def _outside(model: onnx.ModelProto, parts: tuple[str, ...]) -> list[str]:
    """Names of the nodes outside the modules `parts`; exits if all nodes are."""
    outside = []
    for node in model.graph.node:
        scopes = next((p.value for p in node.metadata_props if p.key == SCOPES), "[]")
        if not any(
            scope == p or scope.startswith(p + ".") for scope in _list(scopes) for p in parts
        ):
            outside.append(node.name)
    if len(outside) == len(model.graph.node):
        raise SystemExit(f"--parts: no node of the graph belongs to {', '.join(parts)}")
    return outside


def _list(text: str) -> list[str]:
    try:
        return [str(each) for each in ast.literal_eval(text)]
    except (SyntaxError, ValueError):
        return []


def _fp16(model: onnx.ModelProto, to: Path, outside: list[str]) -> None:
    """Convert to fp16 except the nodes `outside`: heads give exponentials, which lose accuracy."""
    half = float16.convert_float_to_float16(
        copy.deepcopy(model),
        keep_io_types=True,
        disable_shape_infer=True,
        node_block_list=outside,
    )
    _float_stays_float(half)
    onnx.save(half, to, save_as_external_data=half.ByteSize() > WHOLE_BYTES)


def _float_stays_float(half: onnx.ModelProto) -> None:
    """Remove the casts to fp16 and back between float nodes that the conversion inserts.

    They would round depth, and make it infinite above 65504.
    """
    exact = {n.output[0]: n.input[0] for n in half.graph.node if n.name.endswith(HALVED)}
    for node in half.graph.node:
        back = node.op_type == "Cast" and node.attribute[0].i == onnx.TensorProto.FLOAT
        if back and node.input[0] in exact:
            node.op_type, node.input[0] = "Identity", exact[node.input[0]]
            del node.attribute[:]


def _int8(
    model: onnx.ModelProto, to: Path, outside: list[str], windows: list[NDArray[np.float32]]
) -> None:
    """Quantise products with weights to int8. windows: for calibration; none: dynamic.

    Products of two activations (attention) stay float. Ranges are reduced to 7 bits: with 8,
    AVX2 without VNNI overflows.
    """
    # shapes stored by the exporter conflict with the tensors that quantisation adds
    del model.graph.value_info[:]
    weights = {tensor.name for tensor in model.graph.initializer}
    products = [n.name for n in model.graph.node if weights.isdisjoint(n.input)]
    # dynamic quantisation splits a Gemm in two nodes and excludes by the new name
    excluded = [*outside, *products, *(f"{name}_MatMul" for name in outside)]
    big = model.ByteSize() > WHOLE_BYTES
    with tempfile.TemporaryDirectory() as scratch:
        plain = Path(scratch) / "plain.onnx"
        onnx.save(model, plain, save_as_external_data=big)
        if windows:
            quantization.quantize_static(
                plain,
                to,
                Calibration(windows),
                op_types_to_quantize=INT8,
                nodes_to_exclude=excluded,
                per_channel=True,
                reduce_range=True,
                use_external_data_format=big,
            )
        else:
            quantization.quantize_dynamic(
                plain,
                to,
                op_types_to_quantize=INT8,
                nodes_to_exclude=excluded,
                per_channel=True,
                reduce_range=True,
                weight_type=quantization.QuantType.QInt8,
                use_external_data_format=big,
            )


def _windows(source: Path, spec: dict[str, object], count: int) -> list[NDArray[np.float32]]:
    size = (int(str(spec["size_px"])), int(str(spec["height_px"])))
    shown = pictures(source, size, count * CALIBRATION_VIEWS)
    return [
        normalised(shown[i : i + CALIBRATION_VIEWS], spec)
        for i in range(0, len(shown), CALIBRATION_VIEWS)
    ]


def _report(
    where: Path, precision: str, to: Path, model: onnx.ModelProto, outside: list[str]
) -> None:
    """Enter the variant in the manifest; print what stays float, deviation, size and time."""
    folder.set_variant(where, precision, to)
    print(f"{precision}: {_left_float(model, precision, set(outside))}")
    spec = tomllib.loads((where / folder.MANIFEST).read_text())["input"]
    session, before = runtime.session(to), runtime.session(where / "model.onnx")
    with np.load(where / "golden.npz") as golden:
        cases = sorted({name.split("/")[1] for name in golden.files})
        for case in cases:
            image = normalised(golden[f"model/{case}/pictures"], spec)
            for name, found in runtime.run(session, image).items():
                wanted = golden[f"model/{case}/out/{name}"].astype(np.float64)
                error = np.sqrt(np.mean((found - wanted) ** 2))
                size, spread = np.sqrt(np.mean(wanted**2)), np.std(wanted)
                shares = f"{error / size:.4f} of its RMS, {error / spread:.4f} of its spread"
                print(f"{precision} {case} {name}: RMS error {shares}")
    share = _cpu_s(session, image) / _cpu_s(before, image)
    print(f"{precision} {cases[-1]}: {share:.2f} of the processor time of fp32, one thread")
    print(f"{to}: {_bytes(to) / 1e6:.1f} MB of {_bytes(where / 'model.onnx') / 1e6:.1f} MB")


def _left_float(model: onnx.ModelProto, precision: str, outside: set[str]) -> str:
    """Text: number of multiplications and convolutions that stay float, by module."""
    weights = {tensor.name for tensor in model.graph.initializer}
    left: Counter[str] = Counter()
    every = [node for node in model.graph.node if node.op_type in MULTIPLY]
    for node in every:
        of_weights = node.op_type in INT8 and not weights.isdisjoint(node.input)
        if node.name in outside or not (precision == "fp16" or of_weights):
            scopes = next((p.value for p in node.metadata_props if p.key == SCOPES), "[]")
            module = next((scope for scope in _list(scopes) if "." in scope), "the rest")
            left[".".join(module.split(".")[:2])] += 1
    parts = ", ".join(f"{name} {count}" for name, count in left.most_common())
    return f"{left.total()} of {len(every)} multiplications stay float: {parts}"


def _cpu_s(session: InferenceSession, image: NDArray[np.float32]) -> float:
    """Minimum CPU time [s] of some runs; wall time would depend on other load."""
    seconds = []
    for _ in range(TIMED_RUNS):
        begin = time.process_time()
        runtime.run(session, image)
        seconds.append(time.process_time() - begin)
    return min(seconds)


def _bytes(path: Path) -> int:
    """Size of a graph and its external weight files."""
    beside = [path.with_name(name) for name in folder.weight_files(path)]
    return sum(each.stat().st_size for each in [path, *beside])


if __name__ == "__main__":
    main()
