"""Global place descriptor: VLAD of the deep features with PCA whitening.

Not trained by gradient: the visual words are k-means clusters, the projection the principal axes,
both over training clips. Jégou and Chum, "Negative evidences and co-occurences in image
retrieval", 2012.
"""

from __future__ import annotations

import numpy as np
import torch
from pairs import Clips
from scipy.cluster.vq import kmeans2
from torch import Tensor, nn
from torch.nn import functional as F

WORDS = 32
DIMENSIONS = 256
SHARPNESS = 20.0
CLIPS_READ = 120


class Place(nn.Module):
    """Descriptor (B, 256) of unit length from deep features (B, 96, h, w).

    words: (32, 96). projection: (256, 3072).
    """

    def __init__(self, words: Tensor, projection: Tensor, mean: Tensor) -> None:
        super().__init__()
        self.register_buffer("words", words)
        self.register_buffer("projection", projection)
        self.register_buffer("mean", mean)

    def gathered(self, deep: Tensor) -> Tensor:
        """VLAD (B, 32 * 96): sums of residuals to each word, normalised per word and in total."""
        x = F.normalize(deep.flatten(2), dim=1)
        share = torch.softmax(SHARPNESS * (self.words @ x), dim=1)
        rest = share @ x.transpose(1, 2) - share.sum(2, keepdim=True) * self.words
        return F.normalize(F.normalize(rest, dim=2).flatten(1), dim=1)

    def forward(self, deep: Tensor) -> Tensor:
        return F.normalize((self.gathered(deep) - self.mean) @ self.projection.T, dim=1)


def learned_place(encoder: nn.Module, clips: Clips) -> Place:
    """Compute words and projection from four views of CLIPS_READ clips each."""
    random = np.random.default_rng(3)
    deep = []
    with torch.no_grad():
        for _ in range(CLIPS_READ):
            grey = clips.draw(random)["grey"][[0, 3, 4, 5]]
            deep.append(encoder(torch.from_numpy(grey).float()[:, None] / 255)[3])
    features = torch.cat(deep)
    x = F.normalize(features, dim=1).permute(0, 2, 3, 1).reshape(-1, features.shape[1]).numpy()
    words, _ = kmeans2(x[random.choice(len(x), 30_000)], WORDS, iter=20, minit="++", seed=4)
    unit = F.normalize(torch.from_numpy(words).float(), dim=1)
    empty = torch.zeros(1, unit.numel())
    gathered = Place(unit, torch.eye(unit.numel()), empty).gathered(features).numpy()
    mean = gathered.mean(0)
    _, spread, axes = np.linalg.svd(gathered - mean, full_matrices=False)
    scale = 1 / np.sqrt(spread[:DIMENSIONS, None] ** 2 / len(gathered) + 1e-4)
    projection = torch.from_numpy(axes[:DIMENSIONS] * scale).float()
    return Place(unit, projection, torch.from_numpy(mean).float()[None])
