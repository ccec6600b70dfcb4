"""Random scenes of textured rectangles, rendered by ray casting with exact depth.

World axes x right, y down, z ahead, metres; the ground is y = 0. All rays are intersected with all
rectangles by three matrix products, on CPU or GPU.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from optics import Optics
from torch import Tensor

Array = np.ndarray

# Kinds of rectangles: opaque; transparent where its mask is 0; mirror; moving.
SOLID, CUTOUT, MIRROR, MOVING = range(4)
FAR_M = 400.0
MASKS = 24
MASK_SIZE = 64
MIN_DEPTH_M = 0.4
# of the tangents of the angle of view
MARGIN = 0.15


class TextureBank:
    """Textures (N, 256, 256) uint8 with mipmaps in one flat array, sampled by a single gather."""

    def __init__(self, textures: Array, device: torch.device) -> None:
        level = torch.from_numpy(textures).to(device).float().div_(255)
        self.count = len(textures)
        flat, self.sides, starts = [], [], [0]
        while level.shape[-1] >= 4:
            flat.append(level.reshape(-1))
            self.sides.append(level.shape[-1])
            starts.append(starts[-1] + level.numel())
            level = torch.nn.functional.avg_pool2d(level[:, None], 2)[:, 0]
        self.flat = torch.cat(flat)
        self.side = torch.tensor(self.sides, device=device)
        self.start = torch.tensor(starts[:-1], device=device)

    def sample(self, index: Tensor, u: Tensor, v: Tensor, texels: Tensor) -> Tensor:
        """Grey values (P,) in [0, 1] at texture coordinates u, v (P,), period 1.

        texels: (P,) width of an image pixel in texels, which selects the mipmap level.
        """
        level = torch.log2(texels.clamp(min=1.0)).round().long().clamp(max=len(self.sides) - 1)
        side = self.side[level]
        base = self.start[level] + index * side * side
        x = (u - torch.floor(u)) * side - 0.5
        y = (v - torch.floor(v)) * side - 0.5
        x0, y0 = torch.floor(x), torch.floor(y)
        fx, fy = x - x0, y - y0
        columns = [torch.remainder(x0.long() + k, side) for k in (0, 1)]
        rows = [base + torch.remainder(y0.long() + k, side) * side for k in (0, 1)]
        top = self.flat[rows[0] + columns[0]] * (1 - fx) + self.flat[rows[0] + columns[1]] * fx
        low = self.flat[rows[1] + columns[0]] * (1 - fx) + self.flat[rows[1] + columns[1]] * fx
        return top * (1 - fy) + low * fy


@dataclass(frozen=True, slots=True)
class Scene:
    """Q rectangles with points corner + a * right + b * down, a and b in [0, 1].

    corner, right, down: (Q, 3) m, right and down orthogonal. texture: (Q,) index, repeats: (Q, 2)
    per side, offset: (Q, 2), gain, bias: (Q,) of its grey values. kind, mask: (Q,).
    velocity: (Q, 3) m/s. sky: texture index, sky_gain: its gain and bias. masks: (MASKS, 64, 64).
    """

    corner: Tensor
    right: Tensor
    down: Tensor
    texture: Tensor
    repeats: Tensor
    offset: Tensor
    gain: Tensor
    bias: Tensor
    kind: Tensor
    mask: Tensor
    velocity: Tensor
    sky: int
    sky_gain: tuple[float, float]
    masks: Tensor


class _Builder:
    """Collects the rectangles of a scene."""

    def __init__(self, random: np.random.Generator, n_textures: int) -> None:
        self.random = random
        self.n_textures = n_textures
        self.rows: list[tuple[Array, ...]] = []

    def add(
        self,
        corner: Array,
        right: Array,
        down: Array,
        *,
        square_m: float,
        texture: int | None = None,
        kind: int = SOLID,
        velocity: Array | None = None,
        paint: tuple[float, float] | None = None,
    ) -> None:
        random = self.random
        repeats = np.array([np.linalg.norm(right), np.linalg.norm(down)]) / square_m
        gain, bias = paint or (random.uniform(0.5, 1.1), random.uniform(-0.05, 0.25))
        index = int(random.integers(self.n_textures)) if texture is None else texture
        self.rows.append(
            (
                corner, right, down, np.array([index]), repeats, random.uniform(0, 1, 2),
                np.array([gain]), np.array([bias]), np.array([kind]),
                np.array([random.integers(MASKS)]), np.zeros(3) if velocity is None else velocity,
            )
        )  # fmt: skip

    def box(self, centre: Array, size: Array, yaw: float, square_m: float, **paint: object) -> None:
        """Add sides and top of a box standing on the ground; size: width, height, length [m]."""
        c, s = np.cos(yaw), np.sin(yaw)
        x, z = np.array([c, 0, -s]), np.array([s, 0, c])
        up = np.array([0, -size[1], 0])
        width, length = x * size[0], z * size[2]
        base = centre - width / 2 - length / 2
        down = np.array([0, size[1], 0])
        for corner, side in (
            (base, width), (base + width, length), (base + length, width), (base, length),
        ):  # fmt: skip
            self.add(corner + up, side, down, square_m=square_m, **paint)  # type: ignore[arg-type]
        self.add(base + up, width, length, square_m=square_m, **paint)  # type: ignore[arg-type]


def random_scene(random: np.random.Generator, n_textures: int, device: torch.device) -> Scene:
    """A random street (75 %) or random rectangles in all orientations (25 %)."""
    builder = _Builder(random, n_textures)
    if random.random() < 0.25:
        _chaos(builder)
    else:
        _street(builder)
    columns = [np.stack(c) for c in zip(*builder.rows, strict=True)]
    real = [torch.from_numpy(c).to(device, torch.float32) for c in columns]
    corner, right, down, texture, repeats, offset, gain, bias, kind, mask, velocity = real
    noise = torch.from_numpy(random.random((MASKS, 1, 8, 8))).float()
    fine = torch.from_numpy(random.random((MASKS, 1, 24, 24))).float()
    size = (MASK_SIZE, MASK_SIZE)
    resized = torch.nn.functional.interpolate
    blobs = resized(noise, size=size, mode="bicubic") + 0.6 * resized(
        fine, size=size, mode="bicubic"
    )
    masks = (blobs[:, 0] > 0.75).to(device)
    return Scene(
        corner, right, down, texture[:, 0].long(), repeats, offset, gain[:, 0], bias[:, 0],
        kind[:, 0].long(), mask[:, 0].long(), velocity, int(random.integers(n_textures)),
        (float(random.uniform(0, 0.3)), float(random.uniform(0.4, 0.9))), masks,
    )  # fmt: skip


def _street(b: _Builder) -> None:
    random = b.random
    uniform = random.uniform
    b.add(
        np.array([-150.0, 0, -40]), np.array([300.0, 0, 0]), np.array([0, 0, 300.0]),
        square_m=uniform(2, 9),
    )  # fmt: skip
    half, bend = uniform(2.5, 6), uniform(-0.15, 0.15)
    ahead = np.array([np.sin(bend), 0, np.cos(bend)])
    across = np.array([np.cos(bend), 0, -np.sin(bend)])
    start = -20 * ahead + uniform(-1.5, 1.5) * across
    b.add(
        start - half * across - np.array([0, 0.01, 0]), 2 * half * across, 200 * ahead,
        square_m=uniform(1.5, 6), paint=(uniform(0.15, 0.7), uniform(0.05, 0.3)),
    )  # fmt: skip
    if random.random() < 0.7:
        width, length, gap = uniform(0.1, 0.3), uniform(1, 5), uniform(2, 8)
        lines = [0.0] if random.random() < 0.5 else [-half * 0.9, 0.0, half * 0.9]
        white = (uniform(0.1, 0.3), uniform(0.6, 0.8))
        for side in lines:
            for k in range(6):
                at = start + (18 + k * (length + gap)) * ahead + side * across
                b.add(
                    at - np.array([0, 0.02, 0]), width * across, length * ahead,
                    square_m=1.0, paint=white,
                )  # fmt: skip
    for side in (-1, 1):
        z = -12.0
        front = half + uniform(1, 9)
        while z < 90:
            length, height, depth = uniform(5, 22), uniform(3, 16), uniform(4, 12)
            if random.random() < 0.75:
                centre = z * ahead + side * (front + depth / 2 + uniform(0, 3)) * across
                size = np.array([depth, height, length])
                b.box(centre + length / 2 * ahead, size, bend, uniform(1.5, 9))
            z += length + (uniform(0, 8) if random.random() < 0.5 else 0)
        if random.random() < 0.5:
            low = uniform(0.4, 2)
            b.add(
                (half + 0.5) * side * across - np.array([0, low, 0]) - 12 * ahead, 80 * ahead,
                np.array([0, low, 0]), square_m=uniform(0.8, 3),
                kind=CUTOUT if random.random() < 0.3 else SOLID,
            )  # fmt: skip
    for _ in range(random.integers(0, 10)):
        at = uniform(2, 60) * ahead + random.choice([-1, 1]) * uniform(half, half + 9) * across
        height, width = uniform(2, 9), uniform(1.5, 6)
        square_m = uniform(1, 4)
        for direction in (across, ahead):
            b.add(
                at - width / 2 * direction - np.array([0, height, 0]), width * direction,
                np.array([0, height * 0.85, 0]), square_m=square_m, kind=CUTOUT,
            )  # fmt: skip
        pole = uniform(0.1, 0.4)
        b.add(
            at - np.array([pole / 2, height, 0]),
            np.array([pole, 0, 0]),
            np.array([0, height, 0]),
            square_m=1,
        )
    for _ in range(random.integers(0, 5)):
        moving = random.random() < 0.4
        lane = (
            uniform(-half, half) if moving else random.choice([-1, 1]) * uniform(half - 1, half + 2)
        )
        size = np.array([uniform(1.5, 2.3), uniform(1.2, 2.8), uniform(3, 6)])
        speed = (ahead * uniform(-12, 14)) if moving else None
        centre = uniform(5, 50) * ahead + lane * across
        b.box(
            centre, size, bend, uniform(1, 3), velocity=speed,
            kind=MOVING if moving else (MIRROR if random.random() < 0.25 else SOLID),
        )  # fmt: skip


def _chaos(b: _Builder) -> None:
    random = b.random
    b.add(
        np.array([-80.0, -20, random.uniform(25, 70)]), np.array([160.0, 0, 0]),
        np.array([0, 40.0, 0]), square_m=random.uniform(4, 15),
    )  # fmt: skip
    for _ in range(random.integers(12, 45)):
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        size = random.uniform(0.5, 8, 2) * random.uniform(0.5, 2)
        z = random.uniform(2.5, 40)
        centre = np.array([random.uniform(-0.8, 0.8) * z, random.uniform(-0.5, 0.4) * z - 1, z])
        right, down = turn[0] * size[0], turn[1] * size[1]
        b.add(
            centre - right / 2 - down / 2, right, down, square_m=random.uniform(0.7, 6),
            kind=CUTOUT if random.random() < 0.2 else SOLID,
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class View:
    """A rendered view. grey: (H, W) in [0, 1]. depth: (H, W) z [m], FAR_M for sky.

    steady: (H, W) true for static surfaces, false for sky, mirrors and moving objects.
    """

    grey: Tensor
    depth: Tensor
    steady: Tensor


def _in_sight(scene: Scene, T_w_c: Tensor, rays: Tensor, t_s: float) -> Scene:
    """The scene without the rectangles that are entirely outside the view frustum.

    rays: (P, 3) of the view's pixels, z = 1. With a margin for what moves while rows are exposed.
    """
    at = scene.corner + scene.velocity * t_s
    across, down = scene.right, scene.down
    ends = torch.stack([at, at + across, at + down, at + across + down], 1)
    x, y, z = ((ends - T_w_c[:3, 3]) @ T_w_c[:3, :3]).unbind(-1)
    (left, top), (right, foot) = rays[:, :2].amin(0) - MARGIN, rays[:, :2].amax(0) + MARGIN
    sides = [x - left * z, right * z - x, y - top * z, foot * z - y]
    beyond = torch.stack([z - MIN_DEPTH_M / 2, *sides]) < 0
    kept = ~beyond.all(-1).any(0)
    kept[0] |= ~kept.any()
    rows = {
        name: getattr(scene, name)[kept]
        for name in Scene.__dataclass_fields__
        if name not in ("sky", "sky_gain", "masks")
    }
    return replace(scene, **rows)


def render(
    scene: Scene, bank: TextureBank, optics: Optics, t_s: float, readout_s: float = 0.0
) -> View:
    """Render the scene by `optics`, whose middle row is exposed at time t_s [s].

    readout_s: from the first row to the last.
    """
    height, width = optics.camera.height, optics.camera.width
    device = scene.corner.device

    def tensor(values: Array) -> Tensor:
        return torch.from_numpy(values).to(device, torch.float32)

    rows = np.arange(height)
    poses, late = tensor(optics.poses(rows)), tensor(readout_s * optics.share(rows))
    rays_c = tensor(optics.rays())
    ray = (rays_c @ poses[:, :3, :3].transpose(1, 2)).reshape(-1, 3)
    scene = _in_sight(scene, tensor(optics.T_w_c), rays_c.reshape(-1, 3), t_s)
    normal = torch.cross(scene.right, scene.down, dim=1)
    normal = normal / normal.norm(dim=1, keepdim=True)
    across = scene.right / scene.right.pow(2).sum(1, keepdim=True)
    along = scene.down / scene.down.pow(2).sum(1, keepdim=True)
    corner = scene.corner + scene.velocity * (t_s + late)[:, None, None]
    # from the corners to where each row is exposed, (H, Q, 3)
    seen_from = poses[:, None, :3, 3] - corner

    def each(values: Tensor) -> Tensor:
        """Of rows (H, Q) -> of their pixels (P, Q)."""
        return values[:, None].expand(-1, width, -1).reshape(height * width, -1)

    slope = ray @ normal.T
    depth = -each((seen_from * normal).sum(-1)) / torch.where(slope.abs() < 1e-9, 1e-9, slope)
    a = each((seen_from * across).sum(-1)) + depth * (ray @ across.T)
    b = each((seen_from * along).sum(-1)) + depth * (ray @ along.T)
    hit = (depth > MIN_DEPTH_M) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
    cut = torch.nonzero(scene.kind == CUTOUT)[:, 0]
    if len(cut):
        mask_u = (a[:, cut] * scene.repeats[cut, 0].clamp(max=4) % 1 * MASK_SIZE).long()
        mask_v = (b[:, cut] * scene.repeats[cut, 1].clamp(max=4) % 1 * MASK_SIZE).long()
        inside = hit[:, cut]
        mask_u, mask_v = mask_u.clamp(0, MASK_SIZE - 1), mask_v.clamp(0, MASK_SIZE - 1)
        hit[:, cut] = inside & scene.masks[scene.mask[cut], mask_v, mask_u]
    nearest, which = torch.where(hit, depth, torch.inf).min(1)
    sky = torch.isinf(nearest)
    pick = which[:, None]
    u, v = a.gather(1, pick)[:, 0], b.gather(1, pick)[:, 0]
    cosine = slope.gather(1, pick)[:, 0].abs() / ray.norm(dim=1)
    kind = scene.kind[which]
    u = u * scene.repeats[which, 0] + scene.offset[which, 0]
    v = v * scene.repeats[which, 1] + scene.offset[which, 1]
    texels_a_m = 256 * scene.repeats[which, 0] / scene.right.norm(dim=1)[which]
    focal = optics.camera.fx
    texels = texels_a_m * nearest.clamp(max=FAR_M) / focal * cosine.clamp(min=0.02).rsqrt()
    direction = ray / ray.norm(dim=1, keepdim=True)
    n = normal[which]
    mirrored = direction - 2 * (direction * n).sum(1, keepdim=True) * n
    shown = torch.where((kind == MIRROR)[:, None], mirrored, direction)
    skyward = sky | (kind == MIRROR)
    u = torch.where(skyward, shown[:, 0] * 0.9 + 0.3 * shown[:, 2], u)
    v = torch.where(skyward, shown[:, 1] * 0.9, v)
    texels = torch.where(skyward, 256 * 0.9 / focal, texels)
    texture = torch.where(skyward, scene.sky, scene.texture[which])
    gain = torch.where(sky, scene.sky_gain[0], scene.gain[which])
    bias = torch.where(sky, scene.sky_gain[1], scene.bias[which])
    light = torch.where(sky, 1.0, 0.75 + 0.25 * n[:, 0].abs())
    grey = ((bank.sample(texture, u, v, texels) * gain + bias) * light).clamp(0, 1)
    steady = ~sky & (kind != MIRROR) & (kind != MOVING)
    far = torch.where(sky, FAR_M, nearest.clamp(max=FAR_M))
    shape = (height, width)
    return View(grey.reshape(shape), far.reshape(shape), steady.reshape(shape))
