"""Export a network to an ONNX graph with a free number of views, and compute its reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from exporting.patches import Patch, applied
from exporting.runtime import INPUT

OPSET = 20
# above this size weights are stored in an external file: a protobuf is limited to 2 GiB
MAX_INSIDE_BYTES = 1_500_000_000
# number of views for tracing; it must not equal any other dimension
TRACED_VIEWS = 3


@dataclass(frozen=True)
class Network:
    """A network to export. module: preprocessed images (1, N, 3, H, W) -> outputs, in order.

    patches: applied during tracing. original: module with the authors' forward, if `module` has
    another one.
    """

    module: torch.nn.Module
    outputs: tuple[str, ...]
    patches: Sequence[Patch] = ()
    original: torch.nn.Module | None = None


def export(network: Network, size: tuple[int, int], max_views: int, path: Path) -> None:
    """Export to `path` for 2 to max_views images of size (width, height) px."""
    width, height = size
    network.module.eval()
    image = torch.rand(1, TRACED_VIEWS, 3, height, width)
    views = torch.export.Dim("views", min=2, max=max_views)
    with applied(network.patches), torch.no_grad():
        program = torch.onnx.export(
            network.module,
            (image,),
            dynamo=True,
            opset_version=OPSET,
            dynamic_shapes=({1: views},),
            input_names=[INPUT],
            output_names=list(network.outputs),
            verbose=False,
        )
    weights = sum(p.numel() * p.element_size() for p in network.module.parameters())
    program.save(path, external_data=weights > MAX_INSIDE_BYTES)


def reference(network: Network, image: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
    """Outputs of the authors' code by name, without patches."""
    with torch.no_grad():
        values = (network.original or network.module)(torch.from_numpy(image))
    return {
        name: value.float().numpy() for name, value in zip(network.outputs, values, strict=True)
    }
