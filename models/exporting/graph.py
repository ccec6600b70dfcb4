"""A network as an ONNX graph with a free number of views, compared with the network itself."""

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
# a protobuf holds 2 GiB; above this, weights go to a file beside the graph
MAX_INSIDE_BYTES = 1_500_000_000
# what the graph is traced at: a number that is no size of anything else
TRACED_VIEWS = 3


@dataclass(frozen=True)
class Network:
    """module: (1, N, 3, H, W) pictures as the author's network wants them -> the outputs, in order.

    patches: in place while it is traced. original: the same outputs from the author's own forward,
    where `module` is not that.
    """

    module: torch.nn.Module
    outputs: tuple[str, ...]
    patches: Sequence[Patch] = ()
    original: torch.nn.Module | None = None


def export(network: Network, size: tuple[int, int], max_views: int, path: Path) -> None:
    """Writes `path`; size: (width, height) px, of the graph. Views may be 2 to max_views."""
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
    """Outputs of the author's own code by name, none of the patches in place."""
    with torch.no_grad():
        values = (network.original or network.module)(torch.from_numpy(image))
    return {
        name: value.float().numpy() for name, value in zip(network.outputs, values, strict=True)
    }
