"""What stands in a street: cars, trees, lamps, signs, bins, hedges, fences."""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np

from tests.synthetic import textures
from tests.synthetic.surface import UP, Float, Surface, Texture, box, wall
from tests.synthetic.textures import Color, Image

PAINTS: tuple[Color, ...] = (
    (40, 40, 160), (150, 70, 30), (60, 60, 62), (205, 205, 205), (170, 165, 160), (35, 34, 36),
    (60, 110, 60), (90, 160, 200), (120, 60, 40), (50, 120, 215), (140, 120, 90),
)  # fmt: skip
LEAVES: tuple[Color, ...] = ((52, 125, 88), (45, 105, 70), (60, 140, 120), (55, 120, 150))


def _car_side(seed: int, paint: Color, length: float, height: float, density: float) -> Image:
    """A car from its right side, bonnet to the right, (H, W, 4) with its outline cut out."""
    rng = np.random.default_rng([seed, 6])
    h, w = round(height * density), round(length * density)
    sheen = np.linspace(1.2, 0.75, h, dtype=np.float32)[:, None]
    image = textures.tinted(paint, sheen * (1 + 0.03 * textures.fractal(rng, h, w, w / 4, 5)))
    alpha = np.zeros((h, w), np.uint8)

    def at(points: list[tuple[float, float]]) -> np.ndarray:
        return (np.array(points) * (w, h)).astype(np.int32)

    van = seed % 4 == 0
    tail = 0.02 if van else 0.12
    body = [(0.0, 0.45), (tail, 0.42), (tail + 0.06, 0.02), (0.56, 0.0), (0.74, 0.4), (0.97, 0.5),
            (1.0, 0.62), (1.0, 0.86), (0.0, 0.86)]  # fmt: skip
    cv2.fillPoly(alpha, [at(body)], 255)
    glass = [[(tail + 0.05, 0.38), (tail + 0.09, 0.09), (0.34, 0.07), (0.34, 0.38)],
             [(0.36, 0.38), (0.36, 0.07), (0.55, 0.08), (0.69, 0.38)]]  # fmt: skip
    pane = textures.tinted((75, 68, 60), 1 + 0.3 * textures.fractal(rng, h, w, w / 8, 4))
    cover = np.zeros((h, w), np.uint8)
    cv2.fillPoly(cover, [at(g) for g in glass], 255)
    image[cover > 0] = pane[cover > 0]
    seam = [c * 0.5 for c in paint]
    for x in (0.2, 0.35, 0.56):
        cv2.line(image, (int(x * w), int(0.4 * h)), (int(x * w), int(0.84 * h)), seam, 1)
    for x in (0.29, 0.5):
        cv2.line(
            image, (int(x * w), int(0.47 * h)), (int((x + 0.04) * w), int(0.47 * h)), (30,) * 3, 2
        )
    cv2.rectangle(image, (0, int(0.8 * h)), (w, h), (35, 35, 38), -1)
    cv2.rectangle(image, (int(0.95 * w), int(0.53 * h)), (w, int(0.62 * h)), (200, 230, 240), -1)
    cv2.rectangle(image, (0, int(0.47 * h)), (int(0.04 * w), int(0.6 * h)), (30, 30, 190), -1)
    for x in (0.19, 0.81):
        c, r = (int(x * w), int(0.79 * h)), int(0.21 * h)
        cv2.circle(alpha, c, r, 255, -1)
        cv2.circle(image, c, int(r * 1.12), (22, 22, 24), -1)
        cv2.circle(image, c, int(r * 0.62), (150, 152, 155), -1)
        for spoke in np.arange(5) * 1.257 + rng.uniform(0, 1):
            tip = (int(c[0] + 0.55 * r * np.cos(spoke)), int(c[1] + 0.55 * r * np.sin(spoke)))
            cv2.line(image, c, tip, (60, 62, 64), max(1, r // 6))
    for _ in range(14):
        spot = (int(rng.uniform(0, w)), int(rng.uniform(0.6, 0.84) * h))
        cv2.circle(image, spot, max(1, int(0.02 * density)), (70, 85, 100), -1)
    return np.dstack([image, alpha])


def _car_panel(
    seed: int, paint: Color, size: tuple[float, float], kind: str, density: float
) -> Image:
    """Front, rear, bonnet, roof or glass of a car. size: metres across and down."""
    rng = np.random.default_rng([seed, len(kind), ord(kind[0])])
    h, w = max(4, round(size[1] * density)), max(4, round(size[0] * density))
    base: Color = (88, 80, 72) if kind == "glass" else paint
    field = 1 + (0.25 if kind == "glass" else 0.06) * textures.fractal(rng, h, w, w / 2, 5)
    image = textures.tinted(
        base, np.asarray(field * np.linspace(1.1, 0.85, h)[:, None], np.float32)
    )
    cv2.rectangle(image, (0, 0), (w - 1, h - 1), [c * 0.45 for c in base], max(1, w // 40))
    if kind in ("nose", "tail"):
        lamp = (215, 235, 240) if kind == "nose" else (35, 35, 200)
        for x in (0.03, 0.77):
            cv2.rectangle(
                image, (int(x * w), int(0.12 * h)), (int((x + 0.2) * w), int(0.38 * h)), lamp, -1
            )
        cv2.rectangle(
            image, (int(0.27 * w), int(0.15 * h)), (int(0.73 * w), int(0.36 * h)), (40, 40, 42), -1
        )
        cv2.rectangle(image, (0, int(0.72 * h)), (w, h), (38, 38, 40), -1)
        plate = (int(0.32 * w), int(0.5 * h), int(0.68 * w), int(0.7 * h))
        cv2.rectangle(image, plate[:2], plate[2:], (225, 228, 230), -1)
        textures.lettering(image, f"{chr(65 + seed % 26)}{seed * 7 % 9973}", plate, (20, 20, 20))
    return image


def car(centre: Float, forward: Float, seed: int, density: float) -> list[Surface]:
    """A parked car standing at `centre` (3,), its nose towards the unit vector `forward`."""
    rng = np.random.default_rng([seed, 8])
    paint = PAINTS[rng.integers(len(PAINTS))]
    length, width = float(rng.uniform(3.8, 4.7)), float(rng.uniform(1.65, 1.82))
    height = float(rng.uniform(1.38, 1.5)) * (1.25 if seed % 4 == 0 else 1.0)
    right = np.cross(UP, forward) * -1.0
    tail = 0.02 if seed % 4 == 0 else 0.12
    side = Texture(partial(_car_side, seed, paint, length, height, density))

    def at(f: float, r: float, u: float) -> Float:
        """f: 0 tail .. 1 nose; r: -1 left .. 1 right; u: 0 ground .. 1 roof."""
        return np.asarray(
            centre + forward * (f - 0.5) * length + right * r * width / 2 + UP * u * height
        )

    out = [Surface(at(0, 1, 1), at(1, 1, 1) - at(0, 1, 1), -UP * height, side)]
    # the left side is the same picture seen from within: bonnet to the left
    out.append(Surface(at(0, -1, 1), at(1, -1, 1) - at(0, -1, 1), -UP * height, side, True))

    def panel(kind: str, f0: float, u0: float, f1: float, u1: float) -> None:
        """Across the whole width, from (f0, u0) down or back to (f1, u1)."""
        top, foot = at(f0, 0, u0), at(f1, 0, u1)
        size = (width, float(np.linalg.norm(top - foot)))
        texture = Texture(partial(_car_panel, seed, paint, size, kind, density))
        # a plate is read from in front of the car, where its left is the reader's right
        across = right * (-width if kind == "nose" else width)
        out.append(Surface(top - across / 2, across, foot - top, texture, True))

    panel("nose", 1.0, 0.5, 1.0, 0.14)
    panel("bonnet", 0.74, 0.6, 1.0, 0.46)
    panel("glass", 0.56, 1.0, 0.74, 0.6)
    panel("roof", tail + 0.06, 0.98, 0.56, 1.0)
    panel("glass", tail + 0.06, 0.98, tail, 0.58)
    panel("boot", tail, 0.58, 0.0, 0.55)
    panel("tail", 0.0, 0.55, 0.0, 0.14)
    return out


def _bark(seed: int, density: float) -> Image:
    rng = np.random.default_rng([seed, 12])
    h, w = max(8, round(3.2 * density)), max(4, round(0.5 * density))
    streak = cv2.resize(textures.fractal(rng, max(2, h // 6), w, w / 3, 4), (w, h))
    return textures.tinted((62, 78, 92), np.asarray(1 + 0.3 * streak, np.float32))


def tree(foot: Float, seed: int, density: float) -> list[Surface]:
    """A four-sided trunk and a crown of crossing leafy planes that stand still."""
    rng = np.random.default_rng([seed, 13])
    tall, girth = float(rng.uniform(2.0, 2.9)), float(rng.uniform(0.22, 0.4))
    bark = Texture(partial(_bark, seed, density))
    turn = rng.uniform(0, np.pi)
    a = np.array([np.cos(turn), 0, np.sin(turn)]) * girth
    inward = np.cross(a, -UP)
    faces = dict.fromkeys(("front", "left", "right", "back"), bark)
    out = box(foot - (a + inward) / 2, a, inward, tall + 0.8, faces)
    base = LEAVES[rng.integers(len(LEAVES))]
    crown = float(rng.uniform(1.1, 1.5))
    for k in range(9):
        size = crown * float(rng.uniform(1.0, 1.5))
        centre = (
            foot
            + UP * (tall + 0.75 * size + crown * rng.uniform(0, 0.9))
            + np.array([rng.normal(0, 0.4), 0, rng.normal(0, 0.4)]) * crown
        )
        angle = turn + k * np.pi / 4.5 + rng.normal(0, 0.2)
        u = np.array([np.cos(angle), rng.normal(0, 0.2), np.sin(angle)]) * size
        v = -UP * size + np.array([rng.normal(0, 0.35), 0, rng.normal(0, 0.35)])
        pixels = max(16, min(448, round(2 * size * density * 1.6)))

        def clump(k: int = k, pixels: int = pixels) -> Image:
            return textures.foliage(np.random.default_rng([seed, 14, k]), pixels, base)

        out.append(Surface(centre - u - v, 2 * u, 2 * v, Texture(clump), True))
    return out


def post(
    foot: Float, height: float, thick: float, color: Color, seed: int, density: float
) -> list[Surface]:
    """A square post with scuffs."""

    def scuffed() -> Image:
        rng = np.random.default_rng([seed, 16])
        h, w = max(8, round(height * density)), max(3, round(thick * density))
        light = 1 + 0.12 * textures.fractal(rng, h, w, 0.5 * density, 5)
        return textures.tinted(color, np.asarray(light, np.float32))

    faces = dict.fromkeys(("front", "left", "right", "back"), Texture(scuffed))
    x, z = np.array([thick, 0, 0]), np.array([0, 0, thick])
    return box(foot - (x + z) / 2, x, z, height, faces)


def lamp(foot: Float, towards: Float, seed: int, density: float) -> list[Surface]:
    """A street lamp whose arm reaches `towards` (unit vector) the road."""
    out = post(foot, 5.6, 0.14, (88, 96, 92), seed, density)
    across = np.cross(towards, UP)
    grey = Texture(lambda: np.full((6, 24, 3), (90, 96, 96), np.uint8))
    head = foot + UP * 5.5 - across * 0.12
    faces = dict.fromkeys(("front", "left", "right", "back", "bottom", "top"), grey)
    out += box(head, across * 0.24, towards * 1.5, 0.14, faces)
    return out


def sign(foot: Float, facing: Float, seed: int, density: float) -> list[Surface]:
    """A road sign that faces along the unit vector `facing`."""
    rng = np.random.default_rng([seed, 17])

    def plate() -> Image:
        n = max(16, round(0.65 * density))
        image, alpha = np.zeros((n, n, 3), np.uint8), np.zeros((n, n), np.uint8)
        c, kind = n // 2, seed % 3
        if kind == 0:
            image[:], alpha[:] = (150, 80, 20), 255
            textures.lettering(image, "P", (0, 0, n, n), (245, 245, 245))
        elif kind == 1:
            cv2.circle(alpha, (c, c), c - 1, 255, -1)
            cv2.circle(image, (c, c), c, (40, 35, 200), -1)
            cv2.circle(image, (c, c), int(c * 0.72), (240, 240, 240), -1)
            box_px = (n // 5, n // 4, n - n // 5, n - n // 4)
            textures.lettering(image, str(rng.integers(3, 6) * 10), box_px, (20, 20, 20))
        else:
            outer = np.array([[c, 1], [n - 2, n - 3], [1, n - 3]], np.int32)
            inner = np.array(
                [[c, n // 4], [n - n // 5, n - n // 7], [n // 5, n - n // 7]], np.int32
            )
            cv2.fillPoly(alpha, [outer], 255)
            cv2.fillPoly(image, [outer], (40, 35, 200))
            cv2.fillPoly(image, [inner], (240, 240, 240))
            textures.lettering(image, "!", (n // 3, n // 3, 2 * n // 3, n - n // 6), (20, 20, 20))
        return np.dstack([image, alpha])

    out = post(foot, 2.5, 0.07, (150, 150, 150), seed, density)
    right = np.cross(UP, facing)
    left = foot - right * 0.32 + facing * 0.06 + UP * 1.85
    out.append(wall(left, left + right * 0.64, 0.64, Texture(plate), two_sided=True))
    return out


def crate(
    corner: Float,
    along: Float,
    inward: Float,
    height: float,
    color: Color,
    seed: int,
    density: float,
) -> list[Surface]:
    """A box of street furniture: bin, cabinet, skip."""

    def face(w_m: float) -> Image:
        rng = np.random.default_rng([seed, 18, int(w_m * 100)])
        h, w = max(6, round(height * density)), max(4, round(w_m * density))
        image = textures.tinted(color, 1 + 0.1 * textures.fractal(rng, h, w, w / 2, 5))
        cv2.rectangle(image, (1, 1), (w - 2, int(h * 0.14)), [c * 0.6 for c in color], -1)
        label = (w // 5, h // 3, w - w // 5, h // 2)
        cv2.rectangle(image, label[:2], label[2:], textures.muted(rng, 90, 240), -1)
        textures.lettering(image, str(rng.integers(10, 999)), label, (20, 20, 25))
        return textures.weathered(rng, image)

    wide = Texture(partial(face, float(np.linalg.norm(along))))
    deep = Texture(partial(face, float(np.linalg.norm(inward)) + 0.01))
    faces = {"front": wide, "back": wide, "left": deep, "right": deep, "top": deep}
    return box(corner, along, inward, height, faces)


def hedge(
    corner: Float, along: Float, inward: Float, height: float, seed: int, density: float
) -> list[Surface]:
    """A clipped hedge, leafy but solid."""

    def leafy(w_m: float) -> Image:
        rng = np.random.default_rng([seed, 19, int(w_m * 100)])
        h, w = max(8, round(height * density)), max(8, round(w_m * density))
        grain = rng.standard_normal((h, w)).astype(np.float32)
        light = 0.85 + 0.3 * textures.fractal(rng, h, w, 0.3 * density, 5) + 0.18 * grain
        return textures.tinted((50, 105, 72), np.asarray(light, np.float32))

    wide = Texture(partial(leafy, float(np.linalg.norm(along))))
    deep = Texture(partial(leafy, float(np.linalg.norm(inward)) + 0.01))
    faces = {"front": wide, "back": wide, "left": deep, "right": deep, "top": wide}
    return box(corner, along, inward, height, faces)
