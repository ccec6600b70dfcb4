"""A house as surfaces: walls, roof, recessed door, bays, balconies, chimney."""

from __future__ import annotations

from functools import partial

import numpy as np

from tests.synthetic import facade, textures
from tests.synthetic.facade import House
from tests.synthetic.surface import UP, Float, Surface, Texture, box, wall
from tests.synthetic.textures import Image


def house_surfaces(house: House, left: Float, right: Float, light: float) -> list[Surface]:
    """A house whose front stands on left -> right (3,) as seen from the street."""
    rng = np.random.default_rng([house.seed, 3])
    d, seed = house.density, house.seed
    r = (right - left) / np.linalg.norm(right - left)
    inward = np.cross(r, -UP)

    def at(across: float, up: float, deep: float) -> Float:
        return np.asarray(left + r * across + UP * up + inward * deep)

    def material(width: float, height: float, shade: float) -> Texture:
        return Texture(partial(facade.bare, seed, width, height, d, shade * light))

    def painted_front() -> Image:
        return textures.shaded(facade.front(house), light)

    back_left, back_right = at(0, 0, house.depth), at(house.width, 0, house.depth)
    out = [wall(left, right, house.height, Texture(painted_front))]
    flank_height = house.height + house.rise
    flank = Texture(partial(facade.gable, house))
    out += [
        wall(right, back_right, flank_height, flank),
        wall(back_left, left, flank_height, flank),
    ]
    out.append(wall(back_right, back_left, house.height, material(house.width, house.height, 0.7)))
    eave = 0.35
    slope = inward * (house.depth / 2) + UP * house.rise
    overhang = -slope / np.linalg.norm(slope) * eave if house.rise else 0 * slope
    tiles = Texture(partial(facade.roof, house))
    ridge = at(0, house.height, 0) + slope
    out.append(Surface(ridge, r * house.width, -slope + overhang, tiles, True))
    back = inward * (house.depth / 2) - UP * house.rise
    out.append(Surface(ridge + r * house.width, -r * house.width, back, tiles, True))

    x, recess = house.door_left(), float(rng.uniform(0.25, 0.8))
    leaf = Texture(lambda: textures.shaded(facade.door_leaf(seed, d), 0.8 * light))
    out.append(wall(at(x, 0, recess), at(x + 1.1, 0, recess), 2.3, leaf))
    jamb = material(recess, 2.3, 0.6)
    out.append(wall(at(x, 0, 0), at(x, 0, recess), 2.3, jamb))
    out.append(wall(at(x + 1.1, 0, recess), at(x + 1.1, 0, 0), 2.3, jamb))
    for column in range(house.columns):
        if column == house.door or house.floors < 2:
            continue
        kind = rng.uniform()
        width = min(1.9, house.pitch * 0.85)
        start = (column + 0.5) * house.pitch - width / 2
        if kind < 0.16:
            up = house.storey if house.shop or rng.uniform() < 0.5 else 0.25
            out += _bay(house, at(start, up, -0.7), r, inward, width, up, light)
        elif kind < 0.36:
            for floor in range(1, house.floors):
                corner = at(start, floor * house.storey + 0.2, -0.9)
                out += _balcony(house, corner, r, inward, width, light)
    if rng.uniform() < 0.8:
        stack = Texture(partial(facade.bare, seed + 1, 0.9, 2.2, d, 0.8))
        foot = at(float(rng.uniform(0.5, house.width - 1.5)), house.height, house.depth * 0.4)
        sides = dict.fromkeys(("front", "left", "right", "back"), stack)
        out += box(foot, r * 0.9, inward * 0.6, house.rise + 1.1, sides)
    return out


def _bay(
    house: House, corner: Float, r: Float, inward: Float, width: float, up: float, light: float
) -> list[Surface]:
    """A glazed bay that juts out of the front; `corner` is its front left foot."""
    seed, d = house.seed + round(width * 100) + round(up * 7), house.density
    plan = House(width, 1, 1, house.height - up - 0.7, 2, 0, False, 0, seed, d)

    def glazed() -> Image:
        return textures.shaded(facade.front(plan, door=False)[..., :3], light)

    side = Texture(partial(facade.bare, seed, 0.7, plan.height, d, 0.75))
    cap = Texture(partial(facade.bare, seed + 2, width, 0.7, d, 0.5))
    faces = {"front": Texture(glazed), "left": side, "right": side, "top": cap, "bottom": cap}
    return box(corner, r * width, inward * 0.7, plan.height, faces)


def _balcony(
    house: House, corner: Float, r: Float, inward: Float, width: float, light: float
) -> list[Surface]:
    """A slab with an iron railing; `corner` is its front left foot."""
    seed, d = house.seed + 11, house.density
    slab = Texture(partial(facade.bare, seed, width, 0.9, d, 0.55))
    edge = Texture(partial(facade.bare, seed, width, 0.16, d, light))
    rail = Texture(partial(facade.railing, seed, width, d))
    short = Texture(partial(facade.railing, seed + 1, 0.9, d))
    faces = {"front": edge, "left": edge, "right": edge, "top": slab, "bottom": slab}
    out = box(corner, r * width, inward * 0.9, 0.16, faces)
    a, b = corner + UP * 0.16, corner + r * width + UP * 0.16
    out.append(wall(a, b, 1.0, rail, two_sided=True))
    out.append(wall(b, b + inward * 0.9, 1.0, short, two_sided=True))
    out.append(wall(a + inward * 0.9, a, 1.0, short, two_sided=True))
    return out
