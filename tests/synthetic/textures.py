"""Procedural materials as images: every picture here is made of seeded numpy noise and drawing.

Images are (H, W, 3) uint8 BGR or (H, W, 4) with alpha; `density` is texels a metre.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Field = NDArray[np.float32]
Color = tuple[float, float, float]


def fractal(
    rng: np.random.Generator, height: int, width: int, cell: float, octaves: int = 4
) -> Field:
    """(height, width) smooth noise of about unit deviation, largest features `cell` px wide."""
    out = np.zeros((height, width), np.float32)
    weight, total = 1.0, 0.0
    for _ in range(octaves):
        h, w = max(2, int(height / cell) + 2), max(2, int(width / cell) + 2)
        coarse = rng.standard_normal((h, w)).astype(np.float32)
        out += weight * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
        total += weight * weight
        weight *= 0.65
        cell /= 2
        if cell < 1:
            break
    return np.asarray(out / np.sqrt(total), np.float32)


def tinted(base: Color, lightness: Field, *, hue: Field | None = None) -> Image:
    """A colour modulated by `lightness` (1 = as is) and optionally shifted warm / cold by `hue`."""
    out = np.asarray(base, np.float32) * lightness[..., None]
    if hue is not None:
        out = out + hue[..., None] * np.array([-6, 0, 6], np.float32)
    return np.asarray(np.clip(out, 0, 255), np.uint8)


def weathered(rng: np.random.Generator, image: Image, strength: float = 1.0) -> Image:
    """Stains that run down, blotches and grain over any wall."""
    h, w = image.shape[:2]
    streaks = cv2.resize(
        rng.standard_normal((max(2, h // 90), max(2, w // 3))).astype(np.float32),
        (w, h),
        interpolation=cv2.INTER_CUBIC,
    )
    light = 1 + strength * (
        0.06 * fractal(rng, h, w, max(h, w) / 3, 5)
        + 0.035 * streaks
        + 0.04 * rng.standard_normal((h, w)).astype(np.float32)
    )
    # splash-back: the foot of a wall is darker
    light *= 1 - 0.18 * np.exp(-np.arange(h, 0, -1, dtype=np.float32) / (0.05 * h + 4))[:, None]
    rgb = np.clip(image[..., :3].astype(np.float32) * light[..., None], 0, 255).astype(np.uint8)
    return rgb if image.shape[2] == 3 else np.dstack([rgb, image[..., 3]])


def muted(rng: np.random.Generator, low: float, high: float) -> Color:
    """A random colour of restrained saturation, channels in about [low, high]."""
    raw = rng.uniform(low, high, 3)
    b, g, r = 0.45 * raw + 0.55 * raw.mean()
    return float(b), float(g), float(r)


def shaded(image: Image, factor: float) -> Image:
    """The image as lit by `factor` of full light; alpha is kept."""
    out = image.copy()
    out[..., :3] = np.clip(image[..., :3].astype(np.float32) * factor, 0, 255).astype(np.uint8)
    return out


def brick(rng: np.random.Generator, height: int, width: int, density: float, base: Color) -> Image:
    """A running bond of irregular bricks with mortar joints."""
    course = max(2.0, 0.082 * density)
    length = max(4.0, 0.24 * density)
    y = np.arange(height, dtype=np.float32)[:, None]
    x = np.arange(width, dtype=np.float32)[None]
    row = (y / course).astype(int)
    shift = rng.uniform(0, 1, row.max() + 1)[row] * 0.2 + 0.5 * (row % 2)
    along = x / length + shift
    column = along.astype(int)
    tone = rng.normal(1, 0.13, (row.max() + 1, column.max() + 2))
    dark = rng.uniform(size=tone.shape) < 0.07
    tone = np.where(dark, tone * 0.65, tone).astype(np.float32)
    warm = rng.normal(0, 1.5, tone.shape).astype(np.float32)
    image = tinted(base, tone[row, column], hue=warm[row, column])
    joint = ((y % course) < 0.16 * course) | ((along % 1.0) * length < 0.013 * density)
    mortar = np.array([150, 160, 165], np.float32) * rng.uniform(0.75, 1.15)
    return np.where(joint[..., None], mortar, image).astype(np.uint8)


def plaster(
    rng: np.random.Generator, height: int, width: int, density: float, base: Color
) -> Image:
    """Painted render: trowel marks, patches where it was repaired, hairline cracks."""
    light = 1 + 0.05 * fractal(rng, height, width, 0.6 * density, 5)
    image = tinted(base, light)
    for _ in range(rng.integers(1, 4)):
        w, h = (rng.uniform(0.3, 1.6, 2) * density).astype(int)
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, height))
        patch = image[y : y + h, x : x + w].astype(np.float32) * rng.uniform(0.82, 1.1)
        image[y : y + h, x : x + w] = np.clip(patch, 0, 255).astype(np.uint8)
    for _ in range(rng.integers(2, 7)):
        start = rng.uniform(0, 1, 2) * (width, height)
        steps = rng.normal(0, 0.08 * density, (int(rng.integers(6, 25)), 2)) + rng.normal(0, 2, 2)
        line = (start + np.cumsum(steps, 0)).astype(np.int32)
        cv2.polylines(image, [line], False, [int(c * 0.6) for c in base], 1, cv2.LINE_AA)
    return image


def ashlar(rng: np.random.Generator, height: int, width: int, density: float, base: Color) -> Image:
    """Dressed stone blocks of uneven length."""
    image = tinted(base, 1 + 0.07 * fractal(rng, height, width, 0.25 * density, 4))
    y = 0
    while y < height:
        course = max(4, int(rng.uniform(0.25, 0.42) * density))
        x = -int(rng.uniform(0, 0.5) * density)
        while x < width:
            length = max(5, int(rng.uniform(0.35, 0.95) * density))
            block = image[y : y + course, max(x, 0) : max(x + length, 0)]
            block[:] = np.clip(block * rng.normal(1, 0.1), 0, 255).astype(np.uint8)
            joint = tuple(int(c * 0.55) for c in base)
            cv2.rectangle(image, (x, y), (x + length, y + course), joint, 1)
            x += length
        y += course
    return image


def boards(rng: np.random.Generator, height: int, width: int, density: float, base: Color) -> Image:
    """Horizontal weatherboards, each with its own tone and grain."""
    pitch = max(3.0, 0.17 * density)
    y = np.arange(height, dtype=np.float32)[:, None]
    row = (y / pitch).astype(int)
    tone = rng.normal(1, 0.07, row.max() + 1)[row]
    grain = cv2.resize(
        rng.standard_normal((height, max(2, width // 24))).astype(np.float32), (width, height)
    )
    edge = np.where((y % pitch) < 0.12 * pitch, 0.6, 1.0)
    return tinted(base, np.asarray(tone * edge * (1 + 0.06 * grain), np.float32))


def roof_tiles(
    rng: np.random.Generator, height: int, width: int, density: float, base: Color
) -> Image:
    """Overlapping tiles in rows, some replaced, some mossy."""
    row_px, tile_px = max(3.0, 0.3 * density), max(3.0, 0.25 * density)
    y = np.arange(height, dtype=np.float32)[:, None]
    x = np.arange(width, dtype=np.float32)[None]
    row = (y / row_px).astype(int)
    along = x / tile_px + 0.5 * (row % 2)
    column = along.astype(int)
    tone = rng.normal(1, 0.14, (row.max() + 1, column.max() + 2)).astype(np.float32)
    light = tone[row, column] * (0.7 + 0.4 * ((y % row_px) / row_px))
    light = light * np.where((along % 1.0) < 0.1, 0.75, 1.0)
    image = tinted(base, np.asarray(light, np.float32))
    moss = fractal(rng, height, width, 1.5 * density, 5) > 1.4
    image[moss] = (image[moss] * 0.6 + np.array([20, 50, 40])).astype(np.uint8)
    return image


def foliage(rng: np.random.Generator, size: int, base: Color) -> Image:
    """(size, size, 4): a ragged clump of leaves, transparent between and around them."""
    yy, xx = np.mgrid[0:size, 0:size].astype(np.float32)
    c = (size - 1) / 2
    radius = np.hypot(xx - c, yy - c) / c
    clump = fractal(rng, size, size, size / 4, 5)
    sun = 1.02 - 0.3 * (yy / size) + 0.16 * clump
    color = tinted(base, np.asarray(sun * 0.62, np.float32))
    alpha = np.zeros((size, size), np.uint8)
    inside = np.argwhere(radius + 0.28 * clump < 0.88)
    leaf = max(1.3, size / 62)
    # leaves below a texel are not worth their drawing
    count = round(2600 * min(1.0, size / 160))
    picks = inside[rng.integers(0, len(inside), count)]
    tones = rng.normal(1.0, 0.22, count)[:, None] * sun[picks[:, 0], picks[:, 1], None]
    shades = np.clip(np.asarray(base) * tones + rng.normal(0, 5, (count, 3)), 0, 255)
    for (row, col), shade in zip(picks, shades.tolist(), strict=True):
        axes = (max(1, round(leaf * rng.uniform(0.6, 1.4))), max(1, round(leaf * 0.55)))
        turn = float(rng.uniform(0, 180))
        where = (int(col), int(row))
        cv2.ellipse(color, where, axes, turn, 0, 360, shade, -1)
        cv2.ellipse(alpha, where, axes, turn, 0, 360, 255, -1)
    return np.dstack([color, alpha])


def lettering(image: Image, text: str, box: tuple[int, int, int, int], ink: Color) -> None:
    """Write `text` to fill the box (x0, y0, x1, y1), in place."""
    x0, y0, x1, y1 = box
    font, thick = cv2.FONT_HERSHEY_DUPLEX, max(1, (y1 - y0) // 9)
    (w, h), _ = cv2.getTextSize(text, font, 1.0, 1)
    scale = min((x1 - x0) * 0.9 / max(w, 1), (y1 - y0) * 0.65 / max(h, 1))
    at = (int((x0 + x1 - w * scale) / 2), int((y0 + y1 + h * scale) / 2))
    cv2.putText(image, text, at, font, scale, ink, thick, cv2.LINE_AA)
