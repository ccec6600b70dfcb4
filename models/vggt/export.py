"""Export VGGT to a model folder.

    python models/vggt/export.py --repo vggt --checkpoint model.pt --license-file LICENSE.txt

--repo: a checkout of facebookresearch/vggt. The point and track heads are left out: points follow
from poses and depth, and a third of the computation is saved.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from exporting import command, patches
from exporting.graph import Network


class PosesAndDepth(torch.nn.Module):
    """The network with poses and depth, without chunking the depth head by the number of views."""

    def __init__(self, net: torch.nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        tokens, first_patch = self.net.aggregator(images)
        depth, confidence = self.net.depth_head(
            tokens, images=images, patch_start_idx=first_patch, frames_chunk_size=None
        )
        return self.net.camera_head(tokens)[-1], depth, confidence


def build(args: argparse.Namespace) -> Network:
    """Create the network on the CPU, with the checkpoint's weights or random ones."""
    from vggt.layers import rope
    from vggt.models import vggt

    if args.small:
        vggt.Aggregator = partial(_small, vggt.Aggregator)
    net = vggt.VGGT(embed_dim=384 if args.small else 1024)
    net.point_head = net.track_head = None
    if args.small:
        net.depth_head.intermediate_layer_idx = [0, 1, 2, 3]
    command.load(net, args, ignore=("point_head.", "track_head."))
    return Network(
        PosesAndDepth(net),
        ("pose_enc", "depth", "depth_conf"),
        patches.rope(rope.PositionGetter, rope.RotaryPositionEmbedding2D, "base_frequency"),
    )


def _small(aggregator: Any, **given: Any) -> torch.nn.Module:
    less = {"depth": 4, "num_heads": 6, "patch_embed": "dinov2_vits14_reg"}
    made: torch.nn.Module = aggregator(**{**given, **less})
    return made


if __name__ == "__main__":
    command.main(__doc__, Path(__file__).parent, build)
