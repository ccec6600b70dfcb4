"""Export Depth Anything 3 (any-view presets) to a model folder.

    python models/da3/export.py --checkpoint model.safetensors --out models/da3

Needs the authors' code: `pip install --no-deps depth-anything-3` with omegaconf, einops, addict
and safetensors, or a checkout given as --repo.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from exporting import command, patches
from exporting.graph import Network

NEVER = 1 << 40


class AnyView(torch.nn.Module):
    """The network with the first view as reference; poses in the camera decoder's encoding."""

    def __init__(self, net: torch.nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        height, width = images.shape[-2:]
        features, _ = self.net.backbone(
            images, cam_token=None, export_feat_layers=[], ref_view_strategy="first"
        )
        dense = self.net.head(features, height, width, patch_start_idx=0, chunk_size=None)
        return self.net.cam_dec(features[-1][1]), dense["depth"], dense["depth_conf"]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--preset", default="da3-small", help="da3-small, da3-base, da3-large ...")


def build(args: argparse.Namespace) -> Network:
    """Create the network on the CPU, with the checkpoint's weights or random ones."""
    from depth_anything_3.cfg import create_object, load_config
    from depth_anything_3.model.dinov2 import vision_transformer
    from depth_anything_3.model.dinov2.layers import rope
    from depth_anything_3.registry import MODEL_REGISTRY

    if args.preset not in MODEL_REGISTRY:
        raise SystemExit(f"--preset {args.preset}: expected one of {', '.join(MODEL_REGISTRY)}")
    net = create_object(load_config(MODEL_REGISTRY[args.preset]))
    if getattr(net, "cam_dec", None) is None:
        raise SystemExit(f"--preset {args.preset}: has no camera decoder, hence no poses")
    command.load(net, args, prefix="model.")
    return Network(
        AnyView(net.eval()),
        ("pose_enc", "depth", "depth_conf"),
        (
            *patches.rope(rope.PositionGetter, rope.RotaryPositionEmbedding2D, "base_frequency"),
            # disable choosing the reference view by the number of views: a graph cannot branch
            (vision_transformer, "THRESH_FOR_REF_SELECTION", NEVER),
        ),
    )


if __name__ == "__main__":
    command.main(__doc__, Path(__file__).parent, build, add_arguments)
