"""Command line shared by all `export.py`: export, compare with the network, write the folder."""

from __future__ import annotations

import argparse
import shutil
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import torch
from numpy.typing import NDArray

from exporting import folder, graph, runtime
from exporting.graph import Network
from exporting.pictures import normalised, pictures

Build = Callable[[argparse.Namespace], Network]
PARITY_VIEWS = (2, 3, 6)
GOLDEN_VIEWS = (2, 3)


def main(
    doc: str | None,
    here: Path,
    build: Build,
    add_arguments: Callable[[argparse.ArgumentParser], None] = lambda parser: None,
    argv: list[str] | None = None,
) -> None:
    """Run an export. here: folder with template.toml. Exits with one line on errors."""
    parser = argparse.ArgumentParser(description=(doc or "").partition("\n")[0])
    parser.add_argument("--repo", type=Path, help="checkout of the author's code")
    weights = parser.add_mutually_exclusive_group(required=True)
    weights.add_argument("--checkpoint", type=Path, help=".safetensors, .pt or .pth")
    weights.add_argument("--random-weights", action="store_true", help="to test the export")
    parser.add_argument("--small", action="store_true", help="reduced network, to test")
    parser.add_argument("--license-file", type=Path, help="of the weights; with --checkpoint")
    parser.add_argument("--license-name", default="", help="its SPDX name")
    parser.add_argument("--out", type=Path, default=here, help="the model folder to write")
    parser.add_argument("--size", type=_size, default=(504, 280), help="WxH px, multiples of 14")
    parser.add_argument("--max-views", type=int, default=64)
    parser.add_argument("--pictures", type=Path, help="folder of pictures of one scene, for golden")
    parser.add_argument("--tolerance", type=float, default=1e-4, help="of the parity")
    parser.add_argument("--threads", type=int, default=1)
    add_arguments(parser)
    args = parser.parse_args(argv)
    if args.checkpoint and not (args.license_file and args.license_file.is_file()):
        raise SystemExit("--license-file: missing; give the licence of the weights")
    if args.small and not args.random_weights:
        raise SystemExit("--small: only possible with --random-weights")
    if args.max_views < 2:
        raise SystemExit("--max-views: must be at least 2")
    if args.repo:
        sys.path.insert(0, str(args.repo / "src" if (args.repo / "src").is_dir() else args.repo))
    torch.manual_seed(0)
    torch.set_num_threads(args.threads)
    network = _built(build, args)
    _write(args, network, (here / "template.toml").read_text())


def load(
    net: torch.nn.Module, args: argparse.Namespace, prefix: str = "", ignore: tuple[str, ...] = ()
) -> None:
    """Load the checkpoint into `net`, or randomise parts that would be inactive.

    prefix: removed from the checkpoint's names. ignore: prefixes of names that may be missing in
    either. Exits with a message of one line if the checkpoint does not fit.
    """
    if args.random_weights:
        _scramble(net)
        return
    try:
        if args.checkpoint.suffix == ".safetensors":
            from safetensors.torch import load_file

            state = load_file(args.checkpoint)
        else:
            state = torch.load(args.checkpoint, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, ValueError) as error:
        raise SystemExit(f"{args.checkpoint}: cannot be read ({error})") from None
    state = state.get("model", state)
    if prefix and all(name.startswith(prefix) for name in state):
        state = {name[len(prefix) :]: value for name, value in state.items()}
    try:
        missing, unknown = net.load_state_dict(state, strict=False)
    except RuntimeError as error:
        raise SystemExit(f"{args.checkpoint}: {str(error).splitlines()[-1].strip()}") from None
    wrong = [name for name in [*missing, *unknown] if not name.startswith(ignore or ("\0",))]
    if wrong:
        raise SystemExit(
            f"{args.checkpoint}: does not fit: {len(wrong)} names differ, e.g. {wrong[0]}"
        )


def _scramble(net: torch.nn.Module) -> None:
    """Randomise parameters initialised to about zero, so that parity covers all layers."""
    for name, parameter in net.named_parameters():
        with torch.no_grad():
            if name.endswith("gamma"):
                parameter.uniform_(0.3, 1.0)
            elif parameter.abs().max() < 1e-3:
                parameter.normal_(0, 0.02)


def _built(build: Build, args: argparse.Namespace) -> Network:
    try:
        network = build(args)
        network.module.eval()
        return network
    except ModuleNotFoundError as error:
        where = f" or in {args.repo}" if args.repo else "; give a checkout as --repo"
        raise SystemExit(f"the authors' code is missing: no module {error.name}{where}") from None


def _write(args: argparse.Namespace, network: Network, template: str) -> None:
    spec = tomllib.loads(folder.filled(template, (14, 14), 2, "", False))["input"]
    views = sorted({min(n, args.max_views) for n in PARITY_VIEWS})
    shown = pictures(args.pictures, args.size, max(views))
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / "model.onnx"
    graph.export(network, args.size, args.max_views, path)
    session = runtime.session(path, args.threads)
    golden: dict[str, Any] = {}
    for n in views:
        image = normalised(shown[:n], spec)
        expected = graph.reference(network, image)
        _compare(session, image, expected, args.tolerance)
        if n in GOLDEN_VIEWS:
            golden[f"model/n{n}/pictures"] = shown[:n]
            golden |= {f"model/n{n}/out/{name}": value for name, value in expected.items()}
    np.savez_compressed(args.out / "golden.npz", **golden)
    if args.license_file:
        shutil.copyfile(args.license_file, args.out / "LICENSE")
    else:
        (args.out / "LICENSE").write_text("Random weights of a proof: they are nobody's work.\n")
    license_name = args.license_name or ("none needed" if args.random_weights else "see LICENSE")
    text = folder.filled(
        template, args.size, args.max_views, license_name, args.pictures is not None
    )
    (args.out / folder.MANIFEST).write_text(text)
    folder.set_variant(args.out, "fp32", path)
    folder.set_golden(args.out)
    print(f"written: {args.out}; next: calm-edge model check {args.out}")


def _compare(
    session: onnxruntime.InferenceSession,
    image: NDArray[np.float32],
    expected: dict[str, NDArray[np.float32]],
    tolerance: float,
) -> None:
    error, name = runtime.worst_error(runtime.run(session, image), expected)
    views = image.shape[1]
    print(f"{views} views: ONNX against torch, largest error {error:.1e} of the spread ({name})")
    if not error <= tolerance:
        raise SystemExit(f"graph and network differ: {error:.1e} > {tolerance:.1e}")


def _size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r}: expected WxH, e.g. 504x280")
    size = int(width), int(height)
    if any(length < 28 or length % 14 for length in size):
        raise argparse.ArgumentTypeError(f"{text}: both must be multiples of 14, at least 28")
    return size
