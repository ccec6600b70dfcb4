"""Training pairs from rendered clips: two degraded views with true correspondences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from optics import Optics
from torch import Tensor

TEMPORAL = [(i, j) for i in range(4) for j in range(4) if i != j]
ACROSS = [p for i in range(4) for k in (4, 5) for p in ((i, k), (k, i))]
SAME_DEPTH = 0.03


@dataclass(frozen=True, slots=True)
class Pairs:
    """A batch of image pairs a, b: (B, 1, H, W), with points uv_a, uv_b: (B, N, 2) px.

    seen: (B, N) the point is static and visible in b at uv_b. steady: (B, N) the point is on a
    static, non-reflecting surface.
    """

    a: Tensor
    b: Tensor
    uv_a: Tensor
    uv_b: Tensor
    seen: Tensor
    steady: Tensor


def degraded(grey: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Degrade a grey image (H, W), uint8, by exposure, blur, noise and JPEG: float32 in [0, 1]."""
    height, width = grey.shape
    x: np.ndarray = grey.astype(np.float32) / 255
    if random.random() < 0.5:
        shade = cv2.resize(
            random.uniform(0.5, 1.3, (3, 4)).astype(np.float32),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
        x = x * shade
    x = np.clip(
        x * random.uniform(0.45, 1.25) + random.uniform(-0.05, 0.1), 0, 1
    ) ** random.uniform(0.6, 1.6)
    if random.random() < 0.5:
        x = cv2.GaussianBlur(x, (0, 0), random.uniform(0.3, 1.3))
    if random.random() < 0.2:
        length = int(random.integers(3, 10))
        kernel = np.zeros((length, length), np.float32)
        angle = random.uniform(0, np.pi)
        half = (length - 1) / 2
        ends = half + half * np.array(
            [[-np.cos(angle), -np.sin(angle)], [np.cos(angle), np.sin(angle)]]
        )
        cv2.line(
            kernel,
            tuple(np.round(ends[0]).astype(int).tolist()),
            tuple(np.round(ends[1]).astype(int).tolist()),
            1.0,
        )
        x = cv2.filter2D(x, -1, kernel / kernel.sum())
    if random.random() < 0.15:
        x = x * random.uniform(0.08, 0.3)
        x = x + random.normal(0, 0.015, x.shape)
        x = np.clip(x * random.uniform(2, 5), 0, 1)
    x = np.clip(x + random.normal(0, random.uniform(0, 0.03), x.shape), 0, 1)
    if random.random() < 0.3:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(random.integers(35, 90))]
        coded = cv2.imencode(".jpg", (255 * x).astype(np.uint8), quality)[1]
        decoded = np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE), np.float32)
        x = decoded / 255
    return np.asarray(x, np.float32)


def truth(
    uv: np.ndarray, a: Optics, b: Optics, depth_a: np.ndarray, depth_b: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Project integer pixels uv (N, 2) of view a to b: positions (N, 2) px and visibility (N,)."""
    z = depth_a[uv[:, 1], uv[:, 0]]
    uv_b, z_b = b.pixels(a.points(uv, z))
    height, width = depth_b.shape
    # comparisons with NaN are false
    inside = (z > 0) & (uv_b > 4).all(1) & (uv_b < np.array([width, height]) - 5).all(1)
    uv_b = np.where(inside[:, None], uv_b, 0.0)
    x, y = np.round(uv_b).astype(int).T
    there = depth_b[y, x].astype(np.float64)
    return uv_b, inside & (np.abs(there - z_b) < SAME_DEPTH * z_b)


class Clips:
    """The newest `most` shards of a folder, which may still grow."""

    def __init__(self, folder: Path, most: int = 80) -> None:
        self.folder, self.most = folder, most
        self.shards: dict[str, dict[str, np.ndarray]] = {}

    def refresh(self) -> None:
        """Read new shards and drop the oldest ones."""
        for path in sorted(self.folder.glob("[0-9]*.npz")):
            if path.name not in self.shards and ".part" not in path.name:
                with np.load(path) as file:
                    self.shards[path.name] = dict(file)
                if len(self.shards) > self.most:
                    del self.shards[next(iter(self.shards))]

    def draw(self, random: np.random.Generator) -> dict[str, np.ndarray]:
        """Draw a random clip."""
        shard = self.shards[str(random.choice(list(self.shards)))]
        k = random.integers(len(shard["grey"]))
        return {name: value[k] for name, value in shard.items()}


def _pair(
    clip: dict[str, np.ndarray], points: int, random: np.random.Generator
) -> tuple[np.ndarray, ...]:
    i, j = random.choice(TEMPORAL if random.random() < 0.4 else ACROSS)
    a, b = clip["grey"][i], clip["grey"][j]
    height, width = a.shape
    detail = cv2.GaussianBlur(np.abs(cv2.Laplacian(a, cv2.CV_32F)), (0, 0), 2).ravel() + 1.0
    detail = detail.reshape(height, width)
    detail[:6], detail[-6:], detail[:, :6], detail[:, -6:] = 0, 0, 0, 0
    chance = np.sqrt(detail.ravel())
    at = random.choice(height * width, points, replace=False, p=chance / chance.sum())
    uv = np.c_[at % width, at // width]
    fields = [clip[name] for name in ("K", "lens", "T_w_c", "motion")]
    at_a, at_b = (Optics.of([f[k] for f in fields], (height, width)) for k in (i, j))
    uv_b, seen = truth(uv, at_a, at_b, clip["depth"][i], clip["depth"][j])
    steady = clip["steady"][i][uv[:, 1], uv[:, 0]]
    return degraded(a, random), degraded(b, random), uv, uv_b, seen & steady, steady


def batches(clips: Clips, size: int, points: int, seed: int) -> Iterator[Pairs]:
    """Yield batches endlessly; pairs with too few common points are skipped."""
    random = np.random.default_rng(seed)
    while True:
        rows: list[tuple[np.ndarray, ...]] = []
        while len(rows) < size:
            row = _pair(clips.draw(random), points, random)
            if row[4].sum() >= points // 8:
                rows.append(row)
        a, b, uv_a, uv_b, seen, steady = (np.stack(c) for c in zip(*rows, strict=True))
        yield Pairs(
            torch.from_numpy(a)[:, None], torch.from_numpy(b)[:, None],
            torch.from_numpy(uv_a).float(), torch.from_numpy(uv_b).float(),
            torch.from_numpy(seen), torch.from_numpy(steady),
        )  # fmt: skip
