"""The bonnet of the car that carries the cameras: dark paint that mirrors what is ahead."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry.camera import Camera
from tests.synthetic.textures import Image, fractal

Float32 = NDArray[np.float32]
PAINT = np.array([46, 40, 37], np.float32)


@dataclass(frozen=True, slots=True)
class Bonnet:
    """Of one camera. cover: (H, W) share of a pixel that it covers.

    mirrored: (H, W) x and y of the pixels that it mirrors; gloss: (H, W) share of their light.
    shade: (H, W, 3) its own colour.
    """

    cover: Float32
    mirrored: tuple[Float32, Float32]
    gloss: Float32
    shade: Float32

    @classmethod
    def of(cls, camera: Camera, share: float, seed: int) -> Bonnet:
        """A bonnet that hides `share` of the picture's height in its middle, less at the sides."""
        rng = np.random.default_rng([seed, 81])
        w, h = camera.width, camera.height
        x, y = np.meshgrid(np.arange(w, dtype=np.float32), np.arange(h, dtype=np.float32))
        aside = (x - w * (0.5 + rng.uniform(-0.05, 0.05))) / (w / 2)
        edge = h * (1 - share * (1 - 0.45 * aside**2 - 0.25 * aside**4))
        # the sheet is round: the lower, the more it faces up, and the higher up it mirrors
        below = np.maximum(y - edge, 0)
        up = edge - below * (1.6 + 0.02 * below)
        spread = aside * below * 0.5
        ripple = fractal(rng, h, w, w / 6, 4)
        shade = 1 + 0.10 * fractal(rng, h, w, w / 3, 5) + 0.25 * np.exp(-below / 6) - 0.006 * below
        # dust and drops stand still in the picture
        specks = cv2.GaussianBlur((rng.random((h, w)) < 0.004).astype(np.float32), (0, 0), 0.9)
        paint = PAINT * shade[..., None] + 160 * specks[..., None]
        return cls(
            np.clip(y - edge + 0.5, 0, 1).astype(np.float32),
            ((x + spread + 1.5 * ripple).astype(np.float32), (up + ripple).astype(np.float32)),
            (0.10 + 0.28 * np.exp(-below / 14)).astype(np.float32),
            paint.astype(np.float32),
        )

    def over(self, picture: Image) -> Image:
        """The picture (H, W, 3) with the bonnet in front."""
        soft = cv2.GaussianBlur(picture, (0, 0), 1.2)
        mirror = cv2.remap(soft, *self.mirrored, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        sheet = self.shade + self.gloss[..., None] * mirror
        out = picture + self.cover[..., None] * (sheet - picture)
        return np.asarray(np.clip(out + 0.5, 0, 255), np.uint8)
