"""Export Pi3 to a model folder.

    python models/pi3/export.py --repo Pi3 --checkpoint model.safetensors --license-file LICENSE

--repo: a checkout of yyfz/Pi3.
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
from torch.nn import functional

PATCH = 14


class PointsAndPoses(torch.nn.Module):
    """The network with camera-frame points, poses and confidence; world points are left out."""

    def __init__(self, net: torch.nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        net = self.net
        _, views, _, height, width = images.shape
        shown = ((images - net.image_mean) / net.image_std).flatten(0, 1)
        encoded = net.encoder(shown, is_training=True)["x_norm_patchtokens"]
        hidden, positions = net.decode(encoded, views, height, width)
        first = net.patch_start_idx
        dense = net.point_decoder(hidden, xpos=positions)[:, first:]
        xy, log_z = net.point_head([dense], (height, width)).split([2, 1], -1)
        z = log_z.exp()
        certain = net.conf_decoder(hidden, xpos=positions)[:, first:]
        confidence = net.conf_head([certain], (height, width))
        camera = net.camera_decoder(hidden, xpos=positions)[:, first:]
        poses = net.camera_head(camera, height // PATCH, width // PATCH)
        points = torch.cat([xy * z, z], -1)
        return points[None], poses[None, :, :3], confidence[None]


def unit_rows(numbers: torch.Tensor) -> torch.Tensor:
    """Matrices (N, 3, 3) of numbers (N, 9) whose nearest rotation the authors compute by SVD.

    ONNX has no SVD; the manifest makes calm-edge compute the nearest rotation.
    """
    return functional.normalize(numbers.reshape(-1, 3, 3), dim=-1)


def pose_matrix(
    self: Any, views: int, numbers: torch.Tensor, place: torch.Tensor, device: torch.device
) -> torch.Tensor:
    """Pose matrices (N, 3, 4), without assignments to slices, which cannot be exported."""
    return torch.cat([self.svd_orthogonalize(numbers), place[..., None]], -1)


def build(args: argparse.Namespace) -> Network:
    """Create the network on the CPU, with the checkpoint's weights or random ones."""
    from pi3.models import pi3
    from pi3.models.dinov2.hub.backbones import dinov2_vits14_reg
    from pi3.models.layers import camera_head, pos_embed

    if args.small:
        pi3.dinov2_vitl14_reg = dinov2_vits14_reg
        pi3.TransformerDecoder = partial(pi3.TransformerDecoder, depth=2)
    net = pi3.Pi3(decoder_size="small" if args.small else "large")
    if args.small:
        net.decoder = net.decoder[:6]
    command.load(net, args)
    # permanently, not as a patch for tracing: the reference outputs need it too
    net.camera_head.svd_orthogonalize = unit_rows
    return Network(
        PointsAndPoses(net),
        ("local_points", "camera_poses", "conf"),
        (
            *patches.rope(pos_embed.PositionGetter, pos_embed.RoPE2D, "base"),
            (camera_head.CameraHead, "convert_pose_to_4x4", pose_matrix),
        ),
    )


if __name__ == "__main__":
    command.main(__doc__, Path(__file__).parent, build)
