"""The ground: one flat plane painted in square tiles from the distance to the street network."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tests.synthetic import textures
from tests.synthetic.surface import Float, Surface, Texture
from tests.synthetic.textures import Field, Image

TILE_M = 8.0
ROAD_HALF_M = 4.5
PAVEMENT_END_M = 7.0


@dataclass(frozen=True, slots=True)
class Network:
    """Street centre lines sampled every 0.25 m: points, tangents (N, 2), along (N,) metres.

    junction_gap: (N,) metres to the nearest other street along this one.
    """

    points: Float
    tangents: Float
    along: Float
    junction_gap: Float
    street: NDArray[np.int64]
    tree: cKDTree

    @classmethod
    def of(cls, streets: list[Float]) -> Network:
        """From polylines (M, 2) of (x, z) at even spacing."""
        points = np.concatenate(streets)
        tangents, along, ids = [], [], []
        for i, street in enumerate(streets):
            t = np.gradient(street, axis=0)
            tangents.append(t / np.linalg.norm(t, axis=1, keepdims=True))
            along.append(np.r_[0, np.cumsum(np.linalg.norm(np.diff(street, axis=0), axis=1))])
            ids.append(np.full(len(street), i))
        ident = np.concatenate(ids)
        gap = np.full(len(points), 1e3)
        for i in range(len(streets)):
            others = cKDTree(points[ident != i])
            gap[ident == i] = others.query(points[ident == i])[0]
        return cls(
            points, np.concatenate(tangents), np.concatenate(along), gap, ident, cKDTree(points)
        )

    def locate(self, xz: Float) -> tuple[Float, Float, Float, Float]:
        """Of points (..., 2): signed offset to the right, distance, metres along, junction gap."""
        _, i = self.tree.query(xz)
        delta = xz - self.points[i]
        t = self.tangents[i]
        forward = (delta * t).sum(-1)
        side = delta[..., 0] * t[..., 1] - delta[..., 1] * t[..., 0]
        past = forward - np.clip(forward, -0.15, 0.15)
        return side, np.hypot(side, past), self.along[i] + forward, self.junction_gap[i]


@dataclass(frozen=True, slots=True)
class Shadow:
    """A soft dark ellipse: centre (2,), half axes (2,), metres; heading rad; strength 0..1."""

    centre: Float
    half: tuple[float, float]
    heading: float
    strength: float


class Ground:
    """Paints tiles of the plane y = 0. Large features are laid out once for the whole city."""

    def __init__(self, network: Network, shadows: list[Shadow], seed: int, density: float) -> None:
        self.network, self.shadows = network, shadows
        self.seed, self.density = seed, density
        low, high = network.points.min(0) - 24, network.points.max(0) + 24
        self.low = np.floor(low / TILE_M) * TILE_M
        self.count = np.ceil((high - self.low) / TILE_M).astype(int)
        rng = np.random.default_rng([seed, 31])
        size = self.count * int(TILE_M * 4)
        self.blotch = textures.fractal(rng, int(size[1]), int(size[0]), 24, 5)
        self.wear = textures.fractal(rng, int(size[1]), int(size[0]), 8, 4)
        n = len(network.points)
        pick = rng.integers(0, n, n // 5)
        self.crack_at = network.points[pick] + rng.uniform(-4.4, 4.4, (len(pick), 2))
        self.patch_at = network.points[pick[::6]] + rng.uniform(-3.8, 3.8, (len(pick[::6]), 2))

    def surfaces(self) -> list[Surface]:
        """Every tile, seen from above."""
        out = []
        for ix in range(self.count[0]):
            for iz in range(self.count[1]):
                x, z = self.low + TILE_M * np.array([ix, iz])
                out.append(
                    Surface(
                        np.array([x, 0, z + TILE_M]),
                        np.array([TILE_M, 0, 0]),
                        np.array([0, 0, -TILE_M]),
                        Texture(partial(self.paint, ix, iz)),
                    )
                )
        return out

    def _smooth(self, field: Field, ix: int, iz: int, size: int) -> Field:
        cells = int(TILE_M * 4)
        part = field[iz * cells : (iz + 1) * cells + 1, ix * cells : (ix + 1) * cells + 1]
        # rows grow with z, pictures downward: towards the viewer
        return np.asarray(cv2.resize(part[::-1], (size, size), interpolation=cv2.INTER_CUBIC))

    def paint(self, ix: int, iz: int) -> Image:
        """The picture of one tile, (S, S, 3); its top edge is the far (largest z) one."""
        rng = np.random.default_rng([self.seed, 33, ix, iz])
        size = round(TILE_M * self.density)
        origin = self.low + TILE_M * np.array([ix, iz])
        knots = 49
        t = (np.arange(knots)) / (knots - 1) * TILE_M
        gx, gz = np.meshgrid(origin[0] + t, origin[1] + TILE_M - t)
        fields = self.network.locate(np.stack([gx, gz], -1))
        # texel centres between the knots
        at = ((np.arange(size) + 0.5) / size * (knots - 1)).astype(np.float32)
        mx, my = np.meshgrid(at, at)
        side, distance, along, gap = (
            np.asarray(cv2.remap(f.astype(np.float32), mx, my, cv2.INTER_LINEAR), np.float32)
            for f in fields
        )
        blotch, wear = (self._smooth(f, ix, iz, size) for f in (self.blotch, self.wear))
        grain = rng.standard_normal((size, size)).astype(np.float32)
        fine = textures.fractal(rng, size, size, 0.12 * self.density, 3)
        light = 1 + 0.09 * blotch + 0.05 * wear + 0.085 * fine + 0.045 * grain
        tracks = np.exp(-(((np.abs(side) - 1.25) % 2.6 - 0.1) ** 2) / 0.12)
        asphalt = textures.tinted((98, 96, 94), np.asarray(light * (1 - 0.10 * tracks), np.float32))
        image = asphalt
        self._marks(image, side, along, gap, wear + fine)
        image = self._decals(rng, image, origin, size)
        slabs = self._pavement(rng, side, distance, along, light)
        green = textures.tinted(
            (62, 112, 92), np.asarray(1 + 0.15 * fine + 0.12 * grain + 0.15 * wear, np.float32)
        )
        dirt = textures.tinted((98, 122, 140), np.asarray(light, np.float32))
        beyond = np.where((wear + blotch > 0.7)[..., None], dirt, green)
        image = np.where((distance > ROAD_HALF_M)[..., None], slabs, image)
        image = np.where((distance > PAVEMENT_END_M)[..., None], beyond, image)
        kerb = (distance > ROAD_HALF_M - 0.05) & (distance < ROAD_HALF_M + 0.16)
        stone = textures.tinted((158, 162, 165), np.asarray(light, np.float32))
        image = np.where(kerb[..., None], stone, image)
        image = np.where((kerb & ((along % 0.9) < 0.03))[..., None], image * 0.5, image)
        gutter = np.exp(-((distance - ROAD_HALF_M + 0.12) ** 2) / 0.015)
        image = image * (1 - 0.4 * gutter[..., None])
        image = np.clip(image, 0, 255).astype(np.uint8)
        self._litter(rng, image, distance)
        return self._shade(image, gx, gz, mx, my)

    def _marks(self, image: Image, side: Field, along: Field, gap: Field, wear: Field) -> None:
        """Worn paint on the asphalt, in place."""
        worn = wear < 1.7
        open_road = gap > 11.5
        middle = (np.abs(side) < 0.07) & ((along % 5.0) < 2.6) & open_road
        bays = (np.abs(np.abs(side) - 2.55) < 0.05) & ((along % 1.5) < 0.8) & (gap > 14)
        zebra = (gap > 7.2) & (gap < 10) & ((side % 1.0) < 0.5) & (np.abs(side) < 4.2)
        stop = (gap > 10.6) & (gap < 11.0) & (np.abs(side) < 4.3)
        paint = (middle | bays | zebra | stop) & worn
        white = np.clip(205 - 12 * wear, 120, 235)
        image[paint] = (0.25 * image[paint] + 0.75 * white[paint][:, None]).astype(np.uint8)

    def _decals(self, rng: np.random.Generator, image: Image, origin: Float, size: int) -> Image:
        """Repair patches, cracks, manholes and drips. Each is laid down from its own seed."""
        d = self.density

        def pixel(p: Float) -> NDArray[np.int32]:
            q = np.stack([p[..., 0] - origin[0], origin[1] + TILE_M - p[..., 1]], -1) * d - 0.5
            return np.asarray(np.round(q), np.int32)

        def near(points: Float) -> NDArray[np.int64]:
            centre = origin + TILE_M / 2
            return np.flatnonzero(np.abs(points - centre).max(1) < TILE_M / 2 + 3.0)

        for k in near(self.patch_at):
            own = np.random.default_rng([self.seed, 41, int(k)])
            half = own.uniform(0.25, 1.5, 2)
            turn = own.normal(0, 0.1) + np.pi / 2 * own.integers(2)
            R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * half
            corners = pixel(square @ R.T + self.patch_at[k])
            cover = np.zeros((size, size), np.uint8)
            if own.uniform() < 0.3:
                at = pixel(self.patch_at[k])
                radius = max(2, round(0.32 * d))
                iron = np.array([58, 62, 66]) * own.uniform(0.8, 1.3)
                cv2.circle(image, at.tolist(), radius, iron.tolist(), -1)
                cv2.circle(image, at.tolist(), radius, (30, 30, 32), max(1, radius // 8))
                for _ in range(26):
                    q = at + (own.uniform(-0.7, 0.7, 2) * radius).astype(int)
                    tone = float(own.uniform(25, 120))
                    cv2.circle(image, q.tolist(), max(1, radius // 9), (tone, tone, tone), -1)
                continue
            cv2.fillConvexPoly(cover, corners, 255)
            image[cover > 0] = np.clip(image[cover > 0] * own.uniform(0.66, 1.2), 0, 255)
            cv2.polylines(image, [corners], True, (52, 52, 52), max(1, round(0.03 * d)))
        for k in near(self.crack_at):
            own = np.random.default_rng([self.seed, 43, int(k)])
            if own.uniform() < 0.45:
                spread, fade = own.uniform(0.02, 0.2), own.uniform(0.55, 0.85)
                cover = np.zeros((size, size), np.uint8)
                axes = (max(1, round(spread * d)), max(1, round(spread * d * own.uniform(0.5, 1))))
                at = pixel(self.crack_at[k]).tolist()
                cv2.ellipse(cover, at, axes, own.uniform(0, 180), 0, 360, 255, -1)
                image[cover > 0] = (image[cover > 0] * fade).astype(np.uint8)
                continue
            bend = np.cumsum(own.normal(0, 0.5, 16)) + own.uniform(0, 6.3)
            steps = np.stack([np.cos(bend), np.sin(bend)], 1) * own.uniform(0.05, 0.2, (16, 1))
            line = pixel(self.crack_at[k] + np.cumsum(steps, 0))
            width = max(1, round(own.uniform(0.012, 0.03) * d))
            cv2.polylines(image, [line], False, (42, 42, 44), width, cv2.LINE_AA)
        return image

    def _pavement(
        self, rng: np.random.Generator, side: Field, distance: Field, along: Field, light: Field
    ) -> Image:
        """Slabs in a bond, each with its own tone."""
        across = np.floor((distance - ROAD_HALF_M) / 0.62).astype(int)
        shifted = along / 0.92 + 0.5 * (across % 2)
        column = np.floor(shifted).astype(int)
        # a hash, so that a slab cut by a tile's edge keeps its tone
        code = (across * 73856093) ^ (column * 19349663) ^ ((side > 0) * 83492791)
        tone = ((code * 2654435761) % 4093 / 4093 - 0.5) * 0.26 + 1
        slabs = textures.tinted((136, 146, 152), np.asarray(light * tone, np.float32))
        joint = ((distance - ROAD_HALF_M) % 0.62 < 0.025) | (shifted % 1 < 0.025)
        slabs[joint] = (slabs[joint] * 0.62).astype(np.uint8)
        return slabs

    def _litter(self, rng: np.random.Generator, image: Image, distance: Field) -> None:
        """Fallen leaves, gum, scraps: thickest along the kerb. In place."""
        size = len(image)
        for x, y in rng.integers(0, size, (round(900 * min(1.0, self.density / 40)), 2)):
            keep = 0.10 + 0.75 * np.exp(-(((distance[y, x] - ROAD_HALF_M) / 0.7) ** 2))
            if rng.uniform() > keep:
                continue
            axes = (max(1, round(rng.uniform(0.02, 0.06) * self.density)), 1)
            hues = ((40, 120, 190), (50, 90, 140), (70, 130, 120), (200, 205, 210), (60, 60, 64))
            leaf = np.array(hues[rng.integers(5)]) * rng.uniform(0.6, 1.1)
            turn = float(rng.uniform(0, 180))
            cv2.ellipse(image, (int(x), int(y)), axes, turn, 0, 360, leaf.tolist(), -1)

    def _shade(self, image: Image, gx: Float, gz: Float, mx: Field, my: Field) -> Image:
        """Multiply in the soft shadows of what stands here."""
        dark = np.ones_like(gx)
        middle = np.array([gx.mean(), gz.mean()])
        for s in self.shadows:
            if np.abs(s.centre - middle).max() > TILE_M / 2 + 2 * max(s.half):
                continue
            dx, dz = gx - s.centre[0], gz - s.centre[1]
            forward = dx * np.sin(s.heading) + dz * np.cos(s.heading)
            right = dx * np.cos(s.heading) - dz * np.sin(s.heading)
            q = (forward / s.half[1]) ** 4 + (right / s.half[0]) ** 4
            dark *= 1 - s.strength * np.exp(-q)
        light = cv2.remap(dark.astype(np.float32), mx, my, cv2.INTER_LINEAR)
        return np.asarray(image * light[..., None], np.uint8)
