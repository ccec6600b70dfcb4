"""The bonnet in the lower part of a camera's pictures: it stands still and mirrors the scene."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

Array = np.ndarray


@dataclass(frozen=True, slots=True)
class Bonnet:
    """covers: (H, W) bool. mirrored: (H, W) x and y of the pixels that it mirrors, each float32.

    gloss, shade: (H, W) share of their light, and grey values of its own.
    """

    covers: Array
    mirrored: tuple[Array, Array]
    gloss: Array
    shade: Array

    @classmethod
    def drawn(cls, random: np.random.Generator, size: tuple[int, int]) -> Bonnet:
        """A bonnet by lot, hiding 5 to 25 % of the height in its middle; size: height, width."""
        height, width = size
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        aside = (x - width * random.uniform(0.3, 0.7)) / (width / 2)
        round_off, tilt = random.uniform(0, 0.6), random.uniform(-0.15, 0.15)
        edge = height * (1 - random.uniform(0.05, 0.25) * (1 - round_off * aside**2 + tilt * aside))
        below = np.maximum(y - edge, 0)
        up = edge - below * random.uniform(1.0, 2.5)
        spread = aside * below * random.uniform(0, 1)
        clouds = cv2.resize(random.normal(0, 1, (4, 6)).astype(np.float32), (width, height))
        specks = (random.random(size) < random.uniform(0, 0.01)).astype(np.float32)
        shade = random.uniform(10, 90) * (1 + 0.12 * clouds)
        shade = shade + random.uniform(0, 150) * cv2.GaussianBlur(specks, (0, 0), 0.8)
        gloss = random.uniform(0.05, 0.3) + random.uniform(0, 0.4) * np.exp(-below / 12)
        return cls(
            y >= edge,
            ((x + spread).astype(np.float32), (up + clouds).astype(np.float32)),
            gloss.astype(np.float32),
            shade.astype(np.float32),
        )

    def over(self, grey: Array) -> Array:
        """The picture (H, W) uint8 with the bonnet in front."""
        soft = cv2.GaussianBlur(grey, (0, 0), 1.2).astype(np.float32)
        mirror = cv2.remap(soft, *self.mirrored, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        sheet = np.clip(self.shade + self.gloss * mirror + 0.5, 0, 255).astype(np.uint8)
        return np.where(self.covers, sheet, grey)
