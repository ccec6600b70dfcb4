"""Smaller variants of an exported model: int8 (dynamic or static) and fp16, with what they lose.

    python models/quantize.py models/vggt --int8 dynamic
    python models/quantize.py models/vggt --int8 static --pictures drive/ --fp16

Only the parts that share information between views are made int8, the aggregator in VGGT's words:
heads and camera branch drift too far. `calm-edge model check` decides whether a variant is let
pass and whether it is any faster.
"""

from __future__ import annotations

import argparse
import ast
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnxruntime import quantization
from onnxruntime.transformers import float16

sys.path.insert(0, str(Path(__file__).resolve().parent))
from exporting import folder, graph
from exporting.pictures import normalised, pictures

# modules whose multiplications become int8, by the name in the manifest
PARTS = {
    "da3": ("net.backbone",),
    "vggt": ("net.aggregator",),
    "pi3": ("net.encoder", "net.decoder"),
    "mapanything": ("net.encoder", "net.info_sharing"),
}
SCOPES = "pkg.torch.onnx.name_scopes"
CALIBRATION_VIEWS = 4
WHOLE_BYTES = 1_500_000_000


class Calibration(quantization.CalibrationDataReader):
    """Windows of pictures, one a call."""

    def __init__(self, windows: list[NDArray[np.float32]]) -> None:
        self._windows: Iterator[NDArray[np.float32]] = iter(windows)

    def get_next(self) -> dict[str, NDArray[np.float32]] | None:
        """The next window by the name of the input, None behind the last."""
        window = next(self._windows, None)
        return None if window is None else {graph.INPUT: window}


def main(argv: list[str] | None = None) -> None:
    """Exits with one line when something is wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("model", type=Path, help="folder that export.py wrote")
    parser.add_argument("--int8", choices=("dynamic", "static"))
    parser.add_argument(
        "--fp16", action="store_true", help="for a GPU; the processor gains nothing"
    )
    parser.add_argument("--pictures", type=Path, help="folder of pictures to calibrate on")
    parser.add_argument("--windows", type=int, default=8, help="of pictures to calibrate on")
    parser.add_argument("--parts", nargs="+", help="modules to make int8, instead of the known")
    args = parser.parse_args(argv)
    path = args.model / "model.onnx"
    if not path.is_file():
        raise SystemExit(f"{path}: missing; run export.py first")
    if args.int8 == "static" and not args.pictures:
        raise SystemExit("--pictures: missing; static int8 is calibrated on what will be seen")
    if not (args.int8 or args.fp16):
        raise SystemExit("nothing to do: --int8 or --fp16")
    manifest = tomllib.loads((args.model / folder.MANIFEST).read_text())
    parts = args.parts or PARTS.get(manifest["name"])
    if not parts:
        raise SystemExit(f"--parts: missing; none are known of {manifest['name']}")
    model = onnx.load(path)
    # shapes the exporter wrote down contradict the tensors that quantisation adds
    del model.graph.value_info[:]
    outside = _outside(model, tuple(parts))
    if args.int8:
        windows = []
        if args.int8 == "static":
            windows = _windows(args.pictures, manifest["input"], args.windows)
        to = args.model / "model.int8.onnx"
        _int8(model, to, outside, windows)
        _report(args.model, "int8", to)
    if args.fp16:
        to = args.model / "model.fp16.onnx"
        # the heads stay float: depth and confidence are exponentials
        half = float16.convert_float_to_float16(
            model, keep_io_types=True, disable_shape_infer=True, node_block_list=outside
        )
        onnx.save(half, to, save_as_external_data=half.ByteSize() > WHOLE_BYTES)
        _report(args.model, "fp16", to)


def _outside(model: onnx.ModelProto, parts: tuple[str, ...]) -> list[str]:
    """Names of the nodes that belong to none of the modules; exits when they are all."""
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


def _int8(
    model: onnx.ModelProto, to: Path, outside: list[str], windows: list[NDArray[np.float32]]
) -> None:
    """windows: none for dynamic. Ranges are halved: AVX2 without VNNI overflows on full ones."""
    big = model.ByteSize() > WHOLE_BYTES
    with tempfile.TemporaryDirectory() as scratch:
        plain = Path(scratch) / "plain.onnx"
        onnx.save(model, plain, save_as_external_data=big)
        if windows:
            quantization.quantize_static(
                plain,
                to,
                Calibration(windows),
                op_types_to_quantize=["MatMul", "Gemm"],
                nodes_to_exclude=outside,
                per_channel=True,
                reduce_range=True,
                use_external_data_format=big,
            )
        else:
            quantization.quantize_dynamic(
                plain,
                to,
                op_types_to_quantize=["MatMul", "Gemm"],
                nodes_to_exclude=outside,
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


def _report(where: Path, precision: str, to: Path) -> None:
    """Writes the manifest's line and prints how far the golden outputs are off."""
    folder.set_variant(where, precision, to)
    spec = tomllib.loads((where / folder.MANIFEST).read_text())["input"]
    session = graph.session(to)
    with np.load(where / "golden.npz") as golden:
        for case in sorted({name.split("/")[1] for name in golden.files}):
            shown = golden[f"model/{case}/pictures"]
            image = normalised(shown, spec)
            for name, found in graph.run(session, image).items():
                wanted = golden[f"model/{case}/out/{name}"].astype(np.float64)
                error = np.sqrt(np.mean((found - wanted) ** 2))
                size, spread = np.sqrt(np.mean(wanted**2)), np.std(wanted)
                shares = f"{error / size:.4f} of its RMS, {error / spread:.4f} of its spread"
                print(f"{precision} {case} {name}: RMS error {shares}")
    print(f"{to}: {to.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
