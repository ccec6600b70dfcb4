"""A small town round one block: curved streets, houses, gardens, cars, trees, lamps, sky."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.synthetic import things
from tests.synthetic.facade import House
from tests.synthetic.ground import PAVEMENT_END_M, ROAD_HALF_M, Ground, Network, Shadow
from tests.synthetic.house import house_surfaces
from tests.synthetic.path import offset_right, resampled, rounded_loop
from tests.synthetic.render import Scene
from tests.synthetic.surface import Float, Surface
from tests.synthetic.textures import Image, fractal

LANE_M = 1.3
FOOTPRINT = np.stack(np.meshgrid(np.linspace(0, 1, 7), np.linspace(0, 1, 6)), -1).reshape(-1, 2)
SUN = np.array([0.55, -0.7, -0.45])


@dataclass(frozen=True, slots=True)
class World:
    """scene: what is drawn, ground at y = 0 (x right, y down, z forward), metres.

    loop: (N, 2) closed line (x, z) of the right-hand lane round the block, evenly spaced;
    its first point is where the drive starts.
    """

    scene: Scene
    loop: Float


def _street(a: Float, b: Float, bow: float, before: float, after: float) -> tuple[Float, Float]:
    """The street a -> b with a sideways bow, and the same prolonged straight at both ends."""
    length = float(np.linalg.norm(b - a))
    u = (b - a) / length
    normal = np.array([u[1], -u[0]])
    s = np.arange(0, length + 0.01, 0.25)
    t = np.clip((s - 14) / (length - 28), 0, 1)
    inner = a + s[:, None] * u + bow * (np.sin(np.pi * t) ** 2)[:, None] * normal
    s0, s1 = np.arange(-before, -0.1, 0.25), np.arange(length + 0.25, length + after, 0.25)
    return inner, np.concatenate([a + s0[:, None] * u, inner, a + s1[:, None] * u])


def _blocks() -> tuple[list[Float], Float]:
    """Street centre lines, and the lane round the block clockwise from the drive's start."""
    corners = np.array([[0, 0], [0, 86], [62, 86], [62, 0]], np.float64)
    bows = (0.0, 2.4, -3.2, 2.0)
    inner, streets = [], []
    for i in range(4):
        a, b = corners[i], corners[(i + 1) % 4]
        core, whole = _street(a, b, bows[i], 46, 46)
        inner.append(core)
        streets.append(whole)
    # dead-end side streets that leave the loop outwards
    spurs = (
        ((0, 52), (-42, 50)),
        ((62, 40), (104, 44)),
        ((30, 88), (33, 128)),
        ((36, -2), (34, -40)),
    )
    streets += [resampled(np.array(s, np.float64), 0.25) for s in spurs]
    lane = [offset_right(edge, LANE_M) for edge in inner]
    loop = resampled(rounded_loop(lane, np.array([8.0, 7.0, 9.0, 7.5])))
    start = int(np.argmin(np.linalg.norm(loop - (LANE_M, 40.0), axis=1)))
    return streets, np.roll(loop, -start, axis=0)


def _point(xz: Float) -> Float:
    return np.array([xz[0], 0.0, xz[1]])


def _light(normal: Float) -> float:
    """How a wall that faces `normal` is lit."""
    return 0.66 + 0.36 * max(0.0, float(normal @ SUN) / float(np.linalg.norm(SUN[[0, 2]])))


class _Builder:
    """Walks along streets and puts things down where there is room."""

    def __init__(self, network: Network, seed: int, density: float) -> None:
        self.network, self.density = network, density
        self.rng = np.random.default_rng([seed, 51])
        self.surfaces: list[Surface] = []
        self.shadows: list[Shadow] = []
        self.taken: list[NDArray[np.float64]] = []
        self.count = seed * 100_000

    def next_seed(self) -> int:
        self.count += 1
        return self.count

    def _room(self, left: Float, along: Float, inward: Float, clear: float) -> bool:
        """Whether the rectangle keeps `clear` metres from all streets and off other houses."""
        grid = FOOTPRINT  # u across, v deep
        p = left + grid[:, :1] * along + grid[:, 1:] * inward
        # the nearest sample is never nearer than the line: most places fail here, cheaply
        if np.min(self.network.tree.query(p)[0]) < clear or self.network.locate(p)[1].min() < clear:
            return False
        if not self.taken:
            return True
        others = np.array(self.taken)
        others = others[np.abs(others[:, 0] - left).max(1) < 22]
        inside = (p - others[:, :1]) @ np.linalg.inv(others[:, 1:])
        theirs = others[:, :1] + grid[:, :1] * others[:, 1:2] + grid[:, 1:] * others[:, 2:]
        covered = (theirs - left) @ np.linalg.inv(np.stack([along, inward]))
        return not any(((q > 0.005) & (q < 0.995)).all(-1).any() for q in (inside, covered))

    def houses(self, street: Float, side: float) -> None:
        """A row on the right (side 1) or left (-1) of a street."""
        rng = self.rng
        s, gap = float(rng.uniform(0, 2)), 0.25
        set_back = PAVEMENT_END_M + 0.3
        while s < len(street) * gap - 6:
            if rng.uniform() < 0.18:
                set_back = PAVEMENT_END_M + float(rng.choice([0.3, 0.5, 1.6, 3.0]))
            width = float(rng.uniform(6.0, 10.5))
            placed = False
            for trial in (width, 6.0, 4.6):
                placed = self._house(street, side, s, trial, set_back)
                if placed:
                    s += trial + (float(rng.uniform(0.8, 4.0)) if rng.uniform() < 0.22 else 0.02)
                    break
            if not placed:
                s += 1.0

    def _house(self, street: Float, side: float, s: float, width: float, set_back: float) -> bool:
        i, j = int(s / 0.25), int((s + width) / 0.25)
        if j >= len(street):
            return False
        u = (street[j] - street[i]) / np.linalg.norm(street[j] - street[i])
        out = np.array([u[1], -u[0]]) * side
        start = street[i] + out * set_back
        # as seen from the street, left is where we come from on the left side only
        along = u * width
        left = start if side < 0 else start + along
        across = along if side < 0 else -along
        for depth in (9.0, 6.0, 4.0):
            if self._room(left, across, out * depth, PAVEMENT_END_M + 0.15):
                break
        else:
            return False
        rng = self.rng
        floors = int(rng.choice([2, 2, 3, 3, 4]))
        columns = max(2, round(width / float(rng.uniform(1.9, 2.6))))
        house = House(
            width, depth, floors, float(rng.uniform(2.7, 3.3)), columns,
            int(rng.integers(columns)), bool(rng.uniform() < 0.3),
            float(rng.choice([0.0, 1.6, 2.4, 3.0])), self.next_seed(), self.density,
        )  # fmt: skip
        normal = np.array([-out[0], 0, -out[1]])
        a, b = _point(left), _point(left + across)
        self.surfaces += house_surfaces(house, a, b, _light(normal))
        self.taken.append(np.stack([left, across, out * depth]))
        middle = left + across / 2 + out * (depth / 2)
        heading = float(np.arctan2(u[0], u[1]))
        self.shadows.append(Shadow(middle, (depth / 2 + 1.2, width / 2 + 0.8), heading, 0.45))
        if set_back > PAVEMENT_END_M + 1.2:
            self._garden(left, across, out, set_back - PAVEMENT_END_M, house)
        return True

    def _garden(self, left: Float, across: Float, out: Float, deep: float, house: House) -> None:
        """A hedge along the pavement with a gap at the door, and a bush or a tree."""
        u = across / np.linalg.norm(across)
        front = left - out * (deep - 0.15)
        door = house.door_left()
        tall = float(self.rng.uniform(0.6, 1.3))
        for x0, x1 in ((0.1, door - 0.2), (door + 1.3, house.width - 0.1)):
            if x1 - x0 > 0.5:
                corner = _point(front + u * x0)
                self.surfaces += things.hedge(
                    corner, _point(u * (x1 - x0)), _point(out * 0.5), tall, self.next_seed(),
                    self.density,
                )  # fmt: skip
        if deep > 2 and self.rng.uniform() < 0.6:
            foot = front + out * 1.4 + u * float(self.rng.uniform(1, house.width - 1))
            self.surfaces += things.tree(_point(foot), self.next_seed(), self.density)

    def cars(self, street: Float, side: float) -> None:
        """Parked along the kerb, away from junctions."""
        rng, s = self.rng, float(self.rng.uniform(3, 12))
        while s < len(street) * 0.25 - 6:
            i = int(s / 0.25)
            u = (street[i + 4] - street[i]) / np.linalg.norm(street[i + 4] - street[i])
            out = np.array([u[1], -u[0]]) * side
            centre = street[i] + out * (ROAD_HALF_M - 1.02 + rng.normal(0, 0.06))
            _, distance, _, gap = self.network.locate(centre)
            if gap > 15 and distance > 3.0 and rng.uniform() < 0.62:
                turn = float(rng.normal(0, 0.02))
                forward = u * side + np.array([u[1], -u[0]]) * turn
                forward /= np.linalg.norm(forward)
                self.surfaces += things.car(
                    _point(centre), _point(forward), self.next_seed(), self.density
                )
                heading = float(np.arctan2(forward[0], forward[1]))
                self.shadows.append(Shadow(centre, (1.0, 2.4), heading, 0.7))
                s += 5.3 + float(rng.uniform(0, 1.2))
            else:
                s += float(rng.uniform(1.5, 5))

    def furniture(self, street: Float, side: float) -> None:
        """Trees, lamps, signs, bins and bollards on the pavement."""
        rng, s, leafy = self.rng, float(self.rng.uniform(0, 6)), bool(self.rng.uniform() < 0.6)
        while s < len(street) * 0.25 - 3:
            i = int(s / 0.25)
            u = (street[i + 4] - street[i]) / np.linalg.norm(street[i + 4] - street[i])
            out = np.array([u[1], -u[0]]) * side
            foot = street[i] + out * (ROAD_HALF_M + float(rng.uniform(0.45, 0.8)))
            s += float(rng.uniform(3.0, 7.5))
            if self.network.locate(foot)[1] < ROAD_HALF_M + 0.35:
                continue
            self._piece(foot, u, out, leafy)

    def _piece(self, foot: Float, u: Float, out: Float, leafy: bool) -> None:
        rng, seed, d = self.rng, self.next_seed(), self.density
        p, kind = _point(foot), rng.uniform()
        radius = 0.35
        if kind < (0.42 if leafy else 0.15):
            self.surfaces += things.tree(p, seed, d)
            radius = 1.7
        elif kind < 0.53:
            self.surfaces += things.lamp(p, _point(-out), seed, d)
        elif kind < 0.7:
            facing = _point(-u) if rng.uniform() < 0.7 else _point(u)
            self.surfaces += things.sign(p, facing, seed, d)
        elif kind < 0.9:
            color = things.PAINTS[rng.integers(len(things.PAINTS))]
            w, h = rng.uniform(0.45, 1.1), float(rng.uniform(0.8, 1.4))
            corner = foot + out * 1.2 * rng.uniform()
            self.surfaces += things.crate(
                _point(corner),
                _point(u * w),
                np.cross(_point(u * 0.5), [0, 1, 0]),
                h,
                color,
                seed,
                d,
            )
        else:
            for k in range(int(rng.integers(2, 5))):
                self.surfaces += things.post(
                    _point(foot + u * 1.1 * k), 0.95, 0.12, (60, 64, 70), seed + 7 * k, d
                )
        self.shadows.append(Shadow(foot, (radius, radius), 0.0, 0.42))


def sky(seed: int) -> Image:
    """Panorama (512, 2048, 3): blue, layered clouds, and hills with tree tops on the horizon."""
    rng = np.random.default_rng([seed, 61])
    h, w = 512, 2048
    elevation = np.linspace(np.pi / 2, -np.pi / 2, h)[:, None]
    azimuth = np.linspace(-np.pi, np.pi, w, endpoint=False)[None]
    up = np.maximum(np.sin(elevation), 0.06)
    flat = np.cos(elevation) / up
    x = (flat * np.sin(azimuth) * 20 + 512).astype(np.float32)
    y = (flat * np.cos(azimuth) * 20 + 512).astype(np.float32)
    clouds = cv2.remap(
        fractal(rng, 1024, 1024, 70, 6), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    cover = 1 / (1 + np.exp(-3.2 * (clouds + 0.1)))
    blue = (
        np.array([215, 165, 115])
        + (np.array([228, 212, 198]) - [215, 165, 115])
        * np.exp(-3.5 * np.maximum(np.sin(elevation), 0))[..., None]
    )
    white = np.array([246, 244, 242]) - 26 * np.clip(clouds - 0.6, 0, 2)[..., None]
    image = blue * (1 - cover[..., None]) + white * cover[..., None]
    ridge = np.tile(fractal(rng, 1, w // 2, 60, 6), (1, 2))
    ridge[:, w // 2 :] = ridge[:, : w // 2][:, ::-1]
    hills = elevation < np.radians(2.6 + 1.1 * ridge)
    tone = np.array([150, 152, 138]) * (1 + 0.07 * fractal(rng, h, w, 9, 4))[..., None]
    image = np.where(hills[..., None], tone, image)
    return np.asarray(np.clip(image, 0, 255), np.uint8)


def make_world(seed: int = 0, density: float = 48.0) -> World:
    """A town. density: texels a metre of the walls; textures are painted when first seen."""
    streets, loop = _blocks()
    network = Network.of(streets)
    builder = _Builder(network, seed, density)
    for street in streets:
        for side in (1.0, -1.0):
            builder.houses(street, side)
    for street in streets:
        for side in (1.0, -1.0):
            builder.cars(street, side)
            builder.furniture(street, side)
    ground = Ground(network, builder.shadows, seed, density)
    return World(Scene([*builder.surfaces, *ground.surfaces()], sky(seed)), loop)
