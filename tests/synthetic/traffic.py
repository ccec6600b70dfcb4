"""Cars that drive: along the lanes of the town, each at its own speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calm_edge.geometry import se3
from tests.synthetic import things
from tests.synthetic.path import Drive, Limits, offset_right
from tests.synthetic.render import Scene
from tests.synthetic.rows import Part
from tests.synthetic.settings import Settings
from tests.synthetic.surface import Float, Surface, Texture
from tests.synthetic.world import LANE_M

DARK = Texture(lambda: np.full((8, 8, 3), 34, np.uint8))
NO_SKY = np.zeros((1, 1, 3), np.uint8)


@dataclass(frozen=True, slots=True)
class MovingCar:
    """body: its surfaces; x right, y down, z ahead, the rear axle at 0. drive: its poses."""

    body: Scene
    drive: Drive

    def seen(self, t: Float, T_w_c: Float) -> Part:
        """The car for a camera at poses (H, 4, 4) at seconds t (H,)."""
        return Part(self.body, se3.inverse(self.drive.on_ground(t)) @ T_w_c)


def _body(seed: int, density: float) -> Scene:
    """A car and its shadow; the origin is its rear axle, on the ground."""
    middle = np.array([0, 0, 1.3])
    surfaces = things.car(middle, np.array([0, 0, 1.0]), seed, density)
    corner = np.array([-0.8, -0.02, 3.3])
    shadow = Surface(corner, np.array([1.6, 0, 0]), np.array([0, 0, -4.0]), DARK)
    return Scene([*surfaces, shadow], NO_SKY)


def _rounds(loop: Float, share: float) -> Float:
    """Four rounds of a closed line (N, 2), from that share of its length on."""
    return np.concatenate([np.roll(loop, -round(share * len(loop)), axis=0)] * 4)


def cars(loop: Float, settings: Settings) -> list[MovingCar]:
    """Cars round the block in the other lane and ahead of us in ours; loop: (N, 2), our lane."""
    other = offset_right(loop, -2 * LANE_M)[::-1]
    lines = [_rounds(other, s) for s in settings.oncoming]
    lines += [_rounds(loop, s) for s in settings.ahead]
    out = []
    for k, line in enumerate(lines):
        limits = Limits(speed=7.5 + 1.1 * (k % 3), start_speed=6.0)
        if k >= len(settings.oncoming):
            limits = Limits(speed=10.5, sideways=3.2, start_speed=6.0)
        seed = 10 * settings.seed + k
        out.append(MovingCar(_body(901 + seed, settings.density), Drive(line, seed, limits)))
    return out
