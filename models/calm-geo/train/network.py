"""The networks of calm-geo: an image encoder, and the refinement of matches from its features.

3x3 convolutions of at least 32 channels after folding 2x2 pixels to channels, for which int8
kernels are efficient. Inputs are grey images with sides that are multiples of 16.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

COARSE_STRIDE = 8
FINE_STRIDE = 4
COARSE_CHANNELS = 64
FINE_CHANNELS = 32
RADIUS = 4  # of the refinement window, in fine cells
WINDOW = (2 * RADIUS + 1) ** 2


def _conv(inside: int, out: int, stride: int = 1) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inside, out, 3, stride, 1, bias=False), nn.BatchNorm2d(out), nn.ReLU()
    )


class Encoder(nn.Module):
    """Encoder of grey images (B, 1, H, W) in [0, 1].

    Outputs: coarse features (B, 64, H/8, W/8), reliability (B, 1, H/8, W/8) in [0, 1], fine
    features (B, 32, H/4, W/4), deep features (B, 96, H/16, W/16). Coarse and fine features have
    unit length along the channels.
    """

    def __init__(self) -> None:
        super().__init__()
        self.stem = _conv(4, 32)
        self.quarter = _conv(32, 48, 2)
        self.eighth = nn.Sequential(_conv(48, 64, 2), _conv(64, 64))
        self.deep = nn.Sequential(_conv(64, 96, 2), _conv(96, 96), _conv(96, 96))
        self.deep_up = nn.Conv2d(96, 64, 1)
        self.eighth_out = _conv(64, 64)
        self.coarse = nn.Conv2d(64, COARSE_CHANNELS, 1)
        self.reliability = nn.Sequential(nn.Conv2d(64, 32, 1), nn.ReLU(), nn.Conv2d(32, 1, 1))
        self.eighth_up = nn.Conv2d(64, 48, 1)
        self.quarter_out = _conv(48, 48)
        self.fine = nn.Conv2d(48, FINE_CHANNELS, 1)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        mean = image.mean((1, 2, 3), keepdim=True)
        spread = (image - mean).square().mean((1, 2, 3), keepdim=True).sqrt()
        x = F.pixel_unshuffle((image - mean) / (spread + 0.02), 2)
        quarter = self.quarter(self.stem(x))
        eighth = self.eighth(quarter)
        deep = self.deep(eighth)
        eighth = self.eighth_out(eighth + _twice(self.deep_up(deep)))
        quarter = self.quarter_out(quarter + _twice(self.eighth_up(eighth)))
        coarse = F.normalize(self.coarse(eighth), dim=1)
        fine = F.normalize(self.fine(quarter), dim=1)
        return coarse, torch.sigmoid(self.reliability(eighth)), fine, deep


def _twice(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2, mode="nearest")


class Refine(nn.Module):
    """Refinement of matches from the correlations of a point's fine descriptor.

    there, here: (M, 81) correlations with the window around the match, and with that around the
    point itself. Outputs: offset (M, 2) and log of its sigma (M,), in fine cells.
    """

    def __init__(self) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Linear(2 * WINDOW, 128), nn.ReLU(), nn.Linear(128, 96), nn.ReLU(), nn.Linear(96, 3)
        )
        self.sharpness = nn.Parameter(torch.tensor(10.0))
        steps = torch.arange(-RADIUS, RADIUS + 1).float()
        y, x = torch.meshgrid(steps, steps, indexing="ij")
        self.register_buffer("grid", torch.stack([x, y], -1).reshape(-1, 2))

    def forward(self, there: Tensor, here: Tensor) -> tuple[Tensor, Tensor]:
        peak = torch.softmax(there * self.sharpness, 1) @ self.grid
        out = self.layers(torch.cat([there, here], 1))
        return peak + out[:, :2], out[:, 2].clamp(-5, 3)


def sample(features: Tensor, uv: Tensor, stride: int) -> Tensor:
    """Sample features (B, C, h, w) bilinearly at uv (B, N, 2) px of the image: (B, N, C).

    The centre of cell k is at pixel (k + 0.5) * stride - 0.5.
    """
    height, width = features.shape[-2:]
    cells = (uv + 0.5) / stride
    grid = 2 * cells / torch.tensor([width, height], device=uv.device) - 1
    out = F.grid_sample(features, grid[:, :, None], align_corners=False, padding_mode="border")
    return out[..., 0].transpose(1, 2)


def windows(features: Tensor, uv: Tensor) -> Tensor:
    """Sample fine features on a 9 x 9 window, one fine cell apart, around uv: (B, N, 81, 32)."""
    steps = torch.arange(-RADIUS, RADIUS + 1, device=uv.device).float() * FINE_STRIDE
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    around = uv[:, :, None] + torch.stack([x, y], -1).reshape(1, 1, -1, 2)
    b, n = uv.shape[:2]
    return sample(features, around.reshape(b, -1, 2), FINE_STRIDE).reshape(b, n, WINDOW, -1)


def correlations(
    fine_a: Tensor, uv_a: Tensor, fine_b: Tensor, uv_b: Tensor
) -> tuple[Tensor, Tensor]:
    """Inputs of `Refine`, each (B, N, 81), for points uv_a and initial matches uv_b (B, N, 2)."""
    query = F.normalize(sample(fine_a, uv_a, FINE_STRIDE), dim=2)[..., None]
    there = (windows(fine_b, uv_b) @ query)[..., 0]
    here = (windows(fine_a, uv_a) @ query)[..., 0]
    return there, here
