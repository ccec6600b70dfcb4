"""Pictures of a house: its front with windows, shop and stains, its door, roof, gable, railing."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tests.synthetic import textures
from tests.synthetic.textures import Color, Image

WALLS: tuple[Color, ...] = (
    (62, 84, 150), (80, 110, 165), (70, 80, 120), (150, 185, 215), (190, 205, 215),
    (165, 200, 195), (200, 190, 165), (140, 170, 205), (120, 150, 170), (175, 195, 160),
    (90, 105, 140), (205, 210, 212), (150, 160, 200), (110, 160, 200),
)  # fmt: skip
MATERIALS = (
    textures.brick, textures.brick, textures.plaster, textures.plaster,
    textures.ashlar, textures.boards,
)  # fmt: skip
WORDS = (
    "BAKERY", "BOOKS", "CAFE LUNA", "FLORIST", "OPTIK", "KIOSK 24", "PHARMACY", "BIKES & CO",
    "TAILOR", "FRUIT", "HOTEL", "RADIO", "SHOES", "PIZZA ROMA", "BARBER", "KEYS", "ANTIQUES",
    "WINE", "PAPER", "GARAGE", "MUSIC", "TEA HOUSE", "PRINTS", "TOYS",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class House:
    """A house's plan: metres. The door's hole and bay are columns counted from the left."""

    width: float
    depth: float
    floors: int
    storey: float
    columns: int
    door: int
    shop: bool
    rise: float
    seed: int
    density: float

    @property
    def height(self) -> float:
        return self.floors * self.storey + 0.5

    @property
    def pitch(self) -> float:
        """Width of one column of windows."""
        return self.width / self.columns

    def door_left(self) -> float:
        return (self.door + 0.5) * self.pitch - 0.55


def window(
    rng: np.random.Generator, image: Image, x0: int, y0: int, x1: int, y1: int, frame: Color
) -> None:
    """One window in place: reveal, frame, glass with sky and curtains, sill, plants."""
    if x1 - x0 < 4 or y1 - y0 < 4:
        return
    w, h = x1 - x0, y1 - y0
    border = max(1, w // 14)
    cv2.rectangle(image, (x0 - border, y0 - border), (x1 + border, y1), (60, 60, 66), -1)
    cv2.rectangle(image, (x0, y0), (x1, y1), frame, -1)
    gx0, gy0, gx1, gy1 = x0 + border, y0 + border, x1 - border, y1 - border
    gh, gw = max(1, gy1 - gy0), max(1, gx1 - gx0)
    ramp = np.linspace(1.2, 0.6, gh, dtype=np.float32)[:, None]
    glass = ramp * (1 + 0.22 * textures.fractal(rng, gh, gw, max(3, gw / 2), 4))
    image[gy0:gy1, gx0:gx1] = textures.tinted(
        (rng.uniform(55, 120), rng.uniform(50, 95), rng.uniform(40, 80)),
        np.asarray(glass, np.float32),
    )[: gy1 - gy0, : gx1 - gx0]
    kind = rng.integers(0, 6)
    cloth = textures.muted(rng, 110, 235)
    if kind <= 1:
        for x in (gx0, gx1 - gw // 4):
            cv2.rectangle(image, (x, gy0), (x + gw // 4, gy1 - 1), cloth, -1)
            for fold in range(x, x + gw // 4, 3):
                cv2.line(image, (fold, gy0), (fold, gy1 - 1), [c * 0.75 for c in cloth], 1)
    elif kind == 2:
        low = gy0 + int(gh * rng.uniform(0.2, 0.8))
        cv2.rectangle(image, (gx0, gy0), (gx1, low), cloth, -1)
        for y in range(gy0, low, 3):
            cv2.line(image, (gx0, y), (gx1, y), [c * 0.8 for c in cloth], 1)
    bars = int(rng.integers(1, 4))
    for i in range(1, bars):
        x = x0 + w * i // bars
        cv2.line(image, (x, y0), (x, y1), frame, border)
    for split in (0.35,) if rng.uniform() < 0.7 else (0.33, 0.66):
        y = y0 + int(h * split)
        cv2.line(image, (x0, y), (x1, y), frame, border)
    sill = max(1, h // 16)
    cv2.rectangle(image, (x0 - 2 * border, y1), (x1 + 2 * border, y1 + sill), (185, 190, 195), -1)
    cv2.rectangle(image, (x0, y1 + sill), (x1, y1 + 2 * sill), (70, 72, 76), -1)
    if rng.uniform() < 0.25:
        for _ in range(70):
            at = (int(rng.uniform(x0, x1)), int(y1 - abs(rng.normal(0, h * 0.07))))
            leaf = (40, 110, 50) if rng.uniform() < 0.7 else tuple(rng.uniform(60, 255, 3))
            cv2.circle(image, at, max(1, w // 30), leaf, -1)


def _shop_front(rng: np.random.Generator, image: Image, house: House) -> None:
    """Shop windows, goods and a sign over the ground floor, in place."""
    d = house.density
    top, foot = image.shape[0] - int(house.storey * d), image.shape[0]
    paint = textures.muted(rng, 20, 150)
    cv2.rectangle(image, (0, top), (image.shape[1], foot), paint, -1)
    sign = (int(0.2 * d), top + int(0.12 * d), image.shape[1] - int(0.2 * d), top + int(0.68 * d))
    light = sum(paint) < 240
    board = [min(255.0, c * 1.3 + 20) for c in paint]
    cv2.rectangle(image, sign[:2], sign[2:], board, -1)
    word = str(rng.choice(WORDS)) + ("" if rng.uniform() < 0.5 else f" {rng.integers(2, 99)}")
    textures.lettering(image, word, sign, (230, 240, 245) if light else (30, 30, 40))
    for column in range(house.columns):
        if column == house.door:
            continue
        x0 = int((column * house.pitch + 0.18) * d)
        x1 = int(((column + 1) * house.pitch - 0.18) * d)
        y0, y1 = top + int(0.8 * d), foot - int(0.55 * d)
        window(rng, image, x0, y0, x1, y1, paint)
        for _ in range(int(rng.integers(8, 26))):
            w, h = (rng.uniform(0.06, 0.3, 2) * d).astype(int)
            x = int(rng.uniform(x0 + 2, max(x0 + 3, x1 - w - 2)))
            y = y1 - h - 2 - int(abs(rng.normal(0, 0.25)) * d)
            goods = textures.muted(rng, 0, 255)
            cv2.rectangle(image, (x, y), (min(x + w, x1 - 2), y + h), goods, -1)


def front(house: House, *, door: bool = True, blind: float = 0.0) -> Image:
    """The picture of a wall, (H, W, 4): alpha 0 in the doorway. blind: share of missing windows."""
    rng = np.random.default_rng([house.seed, int(door)])
    style = np.random.default_rng([house.seed, 77])
    d = house.density
    h, w = round(house.height * d), round(house.width * d)
    material = MATERIALS[style.integers(len(MATERIALS))]
    base = WALLS[style.integers(len(WALLS))]
    frame: Color = (225, 228, 230) if style.uniform() < 0.65 else (50, 70, 60)
    image = material(rng, h, w, d, base)
    if style.uniform() < 0.5:
        foot = round(0.7 * d)
        image[h - foot :] = textures.ashlar(rng, foot, w, d, (125, 132, 138))
    image = textures.weathered(rng, image)
    ww = float(style.uniform(0.42, 0.62)) * house.pitch
    tall = float(style.uniform(0.46, 0.6)) * house.storey
    lintel = style.uniform() < 0.6
    shutters = style.uniform() < 0.25
    shutter = textures.muted(style, 25, 140)
    if house.shop and door:
        _shop_front(rng, image, house)
    for floor in range(house.floors):
        if floor == 0 and house.shop and door:
            continue
        foot = h - int((floor * house.storey + 0.28 * house.storey) * d)
        for column in range(house.columns):
            if (door and floor == 0 and column == house.door) or rng.uniform() < blind:
                continue
            centre = (column + 0.5) * house.pitch + rng.normal(0, 0.02)
            x0, x1 = int((centre - ww / 2) * d), int((centre + ww / 2) * d)
            y0 = foot - int(tall * d)
            if lintel:
                over = int(0.16 * d)
                where = (x0 - over, y0 - over), (x1 + over, y0)
                cv2.rectangle(image, *where, tuple(float(c) for c in rng.normal(165, 8, 3)), -1)
            window(rng, image, x0, y0, x1, foot, frame)
            if shutters:
                for x in (x0 - int(0.42 * ww * d), x1):
                    cv2.rectangle(image, (x, y0), (x + int(0.42 * ww * d), foot), shutter, -1)
                    for y in range(y0, foot, max(3, int(0.09 * d))):
                        dark = [c * 0.6 for c in shutter]
                        cv2.line(image, (x, y), (x + int(0.42 * ww * d), y), dark, 1)
    for y in (0, h - int(house.storey * d) - int(0.1 * d)):
        tone = float(rng.uniform(110, 200))
        cv2.rectangle(image, (0, y), (w, y + int(0.14 * d)), (tone, tone, tone), -1)
        cv2.rectangle(image, (0, y + int(0.14 * d)), (w, y + int(0.2 * d)), (60, 62, 66), -1)
    pipe = int(0.12 * d) if rng.uniform() < 0.5 else w - int(0.25 * d)
    cv2.rectangle(image, (pipe, 0), (pipe + max(1, int(0.09 * d)), h), (75, 80, 84), -1)
    if door and rng.uniform() < 0.6:
        _bills(rng, image, house)
    alpha = np.full((h, w), 255, np.uint8)
    if door:
        x = int(house.door_left() * d)
        cv2.rectangle(alpha, (x, h - int(2.3 * d)), (x + int(1.1 * d), h), 0, -1)
    return np.dstack([image, alpha])


def _bills(rng: np.random.Generator, image: Image, house: House) -> None:
    """Posters, meter boxes, house number and scribbles on the ground floor, in place."""
    d, (h, w) = house.density, image.shape[:2]
    for _ in range(int(rng.integers(2, 7))):
        bw, bh = (rng.uniform(0.2, 0.7, 2) * d).astype(int)
        x, y = int(rng.uniform(0, max(1, w - bw))), h - int(rng.uniform(0.4, 1.9) * d) - bh // 2
        paper = textures.muted(rng, 60, 240)
        cv2.rectangle(image, (x, y), (x + bw, y + bh), paper, -1)
        textures.lettering(image, str(rng.integers(1, 999)), (x, y, x + bw, y + bh), (25, 25, 35))
    for _ in range(int(rng.integers(0, 3))):
        start = np.array([rng.uniform(0, w), h - rng.uniform(0.4, 1.6) * d])
        line = start + np.cumsum(rng.normal(0, 0.14 * d, (14, 2)), 0)
        ink = textures.muted(rng, 20, 200)
        cv2.polylines(image, [line.astype(np.int32)], False, ink, max(1, int(0.04 * d)))


def door_leaf(seed: int, density: float) -> Image:
    """A panelled door with a fanlight, 1.1 m by 2.3 m."""
    rng = np.random.default_rng([seed, 5])
    h, w = round(2.3 * density), round(1.1 * density)
    base = textures.muted(rng, 15, 140)
    image = textures.boards(rng, w, h, density, base).transpose(1, 0, 2).copy()
    dark = [c * 0.55 for c in base]
    for i in range(int(rng.integers(2, 5))):
        y = int(h * (0.3 + 0.17 * i))
        for x in (0.14, 0.56):
            at = (int(x * w), y), (int((x + 0.3) * w), y + int(0.13 * h))
            cv2.rectangle(image, *at, dark, max(1, w // 28))
    window(rng, image, int(0.12 * w), int(0.05 * h), int(0.88 * w), int(0.22 * h), base)
    cv2.circle(image, (int(0.86 * w), int(0.58 * h)), max(1, w // 22), (60, 190, 215), -1)
    return image


def bare(seed: int, width: float, height: float, density: float, light: float) -> Image:
    """A plain stretch of the house's own material."""
    style = np.random.default_rng([seed, 77])
    material = MATERIALS[style.integers(len(MATERIALS))]
    base = WALLS[style.integers(len(WALLS))]
    rng = np.random.default_rng([seed, int(width * 1000), int(height * 1000)])
    size = max(4, round(height * density)), max(4, round(width * density))
    return textures.shaded(textures.weathered(rng, material(rng, *size, density, base)), light)


def roof(house: House) -> Image:
    """One slope of tiles, with a skylight or two."""
    rng = np.random.default_rng([house.seed, 9])
    colors: tuple[Color, ...] = ((60, 75, 140), (75, 75, 85), (60, 90, 120), (95, 95, 100))
    d = house.density * 0.75
    slope = float(np.hypot(house.depth / 2, house.rise))
    base = colors[rng.integers(4)]
    image = textures.roof_tiles(rng, round(slope * d), round(house.width * d), d, base)
    for _ in range(int(rng.integers(0, 3))):
        x, y = int(rng.uniform(0.1, 0.8) * image.shape[1]), int(image.shape[0] * 0.4)
        window(rng, image, x, y, x + int(0.8 * d), y + int(1.1 * d), (70, 70, 75))
    return image


def gable(house: House) -> Image:
    """A side wall up to the ridge, transparent beside the slopes."""
    flank = front(
        House(house.depth, house.width, house.floors, house.storey, 2, 0, False, 0.0,
              house.seed, house.density),
        door=False, blind=0.45,
    )  # fmt: skip
    rise = round(house.rise * house.density)
    top = bare(house.seed, house.depth, house.rise, house.density, 1.0)
    if rise < 2:
        return textures.shaded(flank, 0.8)
    top = np.asarray(cv2.resize(top, (flank.shape[1], rise)), np.uint8)
    inset = np.abs(np.linspace(-1, 1, flank.shape[1]))[None] < np.linspace(0, 1, rise)[:, None]
    triangle = np.dstack([top, np.where(inset, 255, 0).astype(np.uint8)])
    return textures.shaded(np.vstack([triangle, flank]), 0.8)


def railing(seed: int, width: float, density: float) -> Image:
    """Bars with gaps, washing and flower boxes here and there, (H, W, 4)."""
    rng = np.random.default_rng([seed, 4])
    h, w = max(8, round(density)), max(8, round(width * density))
    image = textures.tinted((52, 55, 58), np.asarray(rng.normal(1, 0.1, (h, w)), np.float32))
    alpha = np.zeros((h, w), np.uint8)
    bar = max(1, round(0.035 * density))
    for x in np.arange(0, w, max(4, 0.13 * density)):
        cv2.rectangle(alpha, (int(x), 0), (int(x) + bar, h), 255, -1)
    alpha[: 2 * bar] = alpha[h - 2 * bar :] = 255
    for _ in range(int(rng.integers(0, 4))):
        x, span = int(rng.uniform(0, w)), int(rng.uniform(0.2, 0.7) * density)
        cloth = textures.muted(rng, 40, 240)
        low = int(rng.uniform(0.25, 0.8) * h)
        cv2.rectangle(image, (x, 0), (x + span, low), cloth, -1)
        cv2.rectangle(alpha, (x, 0), (x + span, low), 255, -1)
    return np.dstack([image, alpha])
