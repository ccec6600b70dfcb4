"""Write the model folder from a checkpoint: ONNX graphs, int8 encoder, golden values, manifest.

python export.py --checkpoint build/calm-geo/checkpoint.pt --clips build/clips
"""

from __future__ import annotations

import argparse
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import torch
from network import FINE_STRIDE, WINDOW, Encoder, Refine, correlations
from onnxruntime.quantization import (
    CalibrationDataReader,
    CalibrationMethod,
    QuantFormat,
    QuantType,
    quantize_static,
)
from onnxruntime.quantization.shape_inference import quant_pre_process
from pairs import Clips, degraded
from place import Place, learned_place
from torch import Tensor, nn
from train import Model

# the shipped model folder
MODEL = Path(__file__).resolve().parents[3] / "calm_edge" / "models" / "calm-geo"
OPSET = 20
CALIBRATION_PICTURES = 48
GOLDEN_SIZES = {"n2": (2, 96, 640), "n3": (3, 64, 640)}
SCRATCH = ("encoder.prepared.onnx",)


class EncoderGraph(nn.Module):
    """Graph `encoder`: encoder and place descriptor."""

    def __init__(self, encoder: Encoder, place: Place) -> None:
        super().__init__()
        self.encoder, self.place = encoder, place

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        coarse, reliability, fine, deep = self.encoder(image)
        return coarse, reliability, fine, self.place(deep)


class RefineGraph(nn.Module):
    """Graph `refine`: correlations (M, 81), (M, 81) to offset (M, 2) and sigma per axis (M,).

    Offset (to be added to the initial match) and sigma are in pixels of the encoder's input.
    """

    def __init__(self, refine: Refine) -> None:
        super().__init__()
        self.refine = refine

    def forward(self, there: Tensor, here: Tensor) -> tuple[Tensor, Tensor]:
        offset, log_sigma = self.refine(there, here)
        return offset * FINE_STRIDE, torch.exp(log_sigma) * FINE_STRIDE


def pictures(clips: Clips, count: int, seed: int) -> Iterator[np.ndarray]:
    """Yield degraded training images (1, 1, H, W), float32 in [0, 1]."""
    random = np.random.default_rng(seed)
    for _ in range(count):
        grey = clips.draw(random)["grey"]
        yield degraded(grey[random.integers(len(grey))], random)[None, None]


class _Calibration(CalibrationDataReader):
    def __init__(self, images: Iterator[np.ndarray]) -> None:
        self.images = images

    def get_next(self) -> dict[str, np.ndarray] | None:
        image = next(self.images, None)
        return None if image is None else {"image": image}


def export_encoder(graph: EncoderGraph, path: Path) -> None:
    free = torch.export.Dim("views", min=1, max=256)
    rows, columns = (torch.export.Dim(name, min=2, max=256) for name in ("rows", "columns"))
    torch.onnx.export(
        graph, (torch.rand(3, 1, 96, 160),), path, opset_version=OPSET, dynamo=True,
        external_data=False, input_names=["image"],
        output_names=["coarse", "reliability", "fine", "place"],
        dynamic_shapes={"image": {0: free, 2: 16 * rows, 3: 16 * columns}},
    )  # fmt: skip


def export_refine(graph: RefineGraph, path: Path) -> None:
    points = torch.export.Dim("points", min=1, max=100_000)
    torch.onnx.export(
        graph, (torch.rand(17, WINDOW), torch.rand(17, WINDOW)), path, opset_version=OPSET,
        dynamo=True, external_data=False, input_names=["there", "here"],
        output_names=["offset", "sigma"],
        dynamic_shapes={"there": {0: points}, "here": {0: points}},
    )  # fmt: skip


def drop_stack_traces(path: Path) -> None:
    """Remove the exporter's metadata of nodes, which contains local file names."""
    model = onnx.load(path)
    for node in model.graph.node:
        del node.metadata_props[:]
    onnx.save(model, path)


def quantise(fp32: Path, int8: Path, clips: Clips) -> None:
    """Static quantisation of the convolutions, weights per channel; the rest stays float."""
    prepared = fp32.with_name(SCRATCH[0])
    quant_pre_process(fp32, prepared, skip_symbolic_shape=True)
    quantize_static(
        prepared, int8, _Calibration(pictures(clips, CALIBRATION_PICTURES, seed=1)),
        quant_format=QuantFormat.QDQ, op_types_to_quantize=["Conv"], per_channel=True,
        activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8, reduce_range=False,
        calibrate_method=CalibrationMethod.Percentile,
        extra_options={"CalibPercentile": 99.99},
    )  # fmt: skip
    prepared.unlink()


def golden(encoder: EncoderGraph, refine: RefineGraph, clips: Clips) -> dict[str, Any]:
    """Golden values: two cases of different shapes per role, computed by torch in float32."""
    random = np.random.default_rng(2)
    out: dict[str, Any] = {}
    for case, (views, height, width) in GOLDEN_SIZES.items():
        grey = clips.draw(random)["grey"][:views]
        tiled = np.tile(grey, (1, 1, 2))[:, :height, :width]
        shown = np.stack([tiled] * 3, -1)
        image = torch.from_numpy(tiled).float()[:, None] / 255
        with torch.no_grad():
            coarse, reliability, fine, place = encoder(image)
            points = torch.from_numpy(random.uniform(4, 60, (1, 20 + views, 2))).float()
            near = points + torch.from_numpy(random.normal(0, 3, points.shape)).float()
            there, here = (c[0] for c in correlations(fine[:1], points, fine[1:2], near))
            offset, sigma = refine(there, here)
        out[f"encoder/{case}/pictures"] = shown
        for name, value in zip(
            ("coarse", "reliability", "fine", "place"),
            (coarse, reliability, fine, place),
            strict=True,
        ):
            out[f"encoder/{case}/out/{name}"] = value.numpy()
        out |= {f"refine/{case}/in/there": there.numpy(), f"refine/{case}/in/here": here.numpy()}
        out |= {
            f"refine/{case}/out/offset": offset.numpy(),
            f"refine/{case}/out/sigma": sigma.numpy(),
        }
    return out


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_manifest(folder: Path, int8_encoder: bool) -> None:
    """Write manifest.toml with the hashes of the folder's files."""

    def entry(file: str) -> str:
        return f'{{ file = "{file}", sha256 = "{_digest(folder / file)}" }}'

    int8 = ["int8 = " + entry("encoder.int8.onnx")] if int8_encoder else []
    lines = [
        "format = 1", 'name = "calm-geo"', 'kind = "bundle"', 'license = "LICENSE"',
        'source = "trained by train/ on random worlds"', 'unmeasured = "int8"', "",
        "[graphs.encoder]",
        "fp32 = " + entry("encoder.onnx"), *int8, 'inputs = ["image"]',
        'outputs = ["coarse", "reliability", "fine", "place"]', "", "[graphs.refine]",
        "fp32 = " + entry("refine.onnx"),
        *(["int8 = " + entry("refine.onnx")] if int8_encoder else []),
        'inputs = ["there", "here"]', 'outputs = ["offset", "sigma"]', "",
        "[input]", 'name = "image"', 'layout = "NCHW"', 'channels = "gray"',
        'resize = "longest"', "size_px = 640", "multiple = 16", "",
        "[frames]", "min = 1", "max = 64", "dynamic = true", "",
        "[golden]", f'sha256 = "{_digest(folder / "golden.npz")}"',
        "int8 = 0.3", "scene = false",
    ]  # fmt: skip
    (folder / "manifest.toml").write_text("\n".join(lines) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--checkpoint", type=Path, required=True)
    parser.add_argument("--clips", type=Path, default=Path("build/clips"))
    parser.add_argument("--out", type=Path, default=MODEL)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    model = Model()
    model.load_state_dict(torch.load(arguments.checkpoint, map_location="cpu")["model"])
    model.eval()
    clips = Clips(arguments.clips, most=8)
    clips.refresh()
    encoder = EncoderGraph(model.encoder, learned_place(model.encoder, clips)).eval()
    refine = RefineGraph(model.refine).eval()
    export_encoder(encoder, arguments.out / "encoder.onnx")
    export_refine(refine, arguments.out / "refine.onnx")
    for name in ("encoder.onnx", "refine.onnx"):
        drop_stack_traces(arguments.out / name)
    quantise(arguments.out / "encoder.onnx", arguments.out / "encoder.int8.onnx", clips)
    np.savez_compressed(arguments.out / "golden.npz", **golden(encoder, refine, clips))
    write_manifest(arguments.out, int8_encoder=True)
    for path in sorted(arguments.out.glob("*.onnx")):
        onnxruntime.InferenceSession(path)
        print(f"{path.name}: {path.stat().st_size / 2**20:.2f} MiB")


if __name__ == "__main__":
    main()
