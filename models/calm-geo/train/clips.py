"""Render clips: six views of a random scene with two random cameras on a random drive.

    python clips.py --textures build/textures.npz --out build/clips --count 3000

Views 0 to 3 are the primary's, in driving order; 4 and 5 the assistant's, near views 1 and 2. All
have exact depth. Lenses, rolling shutters and bonnets are drawn by lot.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from bonnet import Bonnet
from optics import Optics, drawn_camera
from scipy.spatial.transform import Rotation
from textures import load
from world import TextureBank, random_scene, render

from calm_edge.geometry import se3

VIEWS = 6
SIZE = (192, 352)
SHARD = 50


@dataclass(frozen=True, slots=True)
class Clip:
    """A rendered clip. grey: (6, H, W) uint8. depth: (6, H, W) float16, m, 0 on the bonnet.

    steady: (6, H, W) bool, static and not reflecting. K, lens, T_w_c, motion: of the six views, as
    in `optics`.
    """

    grey: np.ndarray
    depth: np.ndarray
    steady: np.ndarray
    K: np.ndarray
    lens: np.ndarray
    T_w_c: np.ndarray
    motion: np.ndarray


def _pose(rotation: Rotation, centre: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), centre
    return T


Camera = tuple[np.ndarray, np.ndarray]


def _kit(random: np.random.Generator) -> tuple[Camera, Camera, np.ndarray]:
    """Random K and lens of both cameras, and T_p_a."""
    hfov = random.uniform(40, 110)
    ratio = 2 ** random.uniform(-1, 1) if random.random() < 0.5 else 2 ** random.uniform(-0.2, 0.2)
    other = np.degrees(2 * np.arctan(np.tan(np.radians(hfov) / 2) * ratio))
    most = 8 if random.random() < 0.6 else 20
    turn = Rotation.from_euler("yxz", random.uniform(-most, most, 3) * [0.7, 0.5, 1], degrees=True)
    side = random.choice([-1, 1]) * random.uniform(0.15, 1.3)
    T_p_a = _pose(turn, np.array([side, random.uniform(-0.1, 0.1), random.uniform(-0.2, 0.2)]))
    primary = drawn_camera(random, hfov, SIZE)
    return primary, drawn_camera(random, float(np.clip(other, 25, 115)), SIZE), T_p_a


def _motion(
    random: np.random.Generator,
    T_w_p: np.ndarray,
    T_p_a: np.ndarray,
    velocity: np.ndarray,
    turn_rate: float,
) -> np.ndarray:
    """Twists (6, 6) per second of the views, of T_w_p (4, 4, 4) and of the assistant beside 1, 2.

    velocity: (4, 3) in the world, turn_rate: of the car. A shaking mount is added.
    """
    twists = []
    for T, v in zip(T_w_p, velocity, strict=True):
        turn = T[:3, :3].T @ np.array([0, turn_rate, 0]) + random.normal(0, 0.15, 3)
        twists.append(np.r_[T[:3, :3].T @ v, turn])
    of_assistant = se3.adjoint(se3.inverse(T_p_a))
    return np.stack([*twists, of_assistant @ twists[1], of_assistant @ twists[2]])


def random_clip(random: np.random.Generator, bank: TextureBank, device: torch.device) -> Clip:
    """Render a clip with scene, cameras and drive drawn from `random`."""
    scene = random_scene(random, bank.count, device)
    primary_camera, assistant_camera, T_p_a = _kit(random)
    speed = random.uniform(2, 25)
    steps = np.r_[0, random.uniform(0.15, 3.0) * random.uniform(0.5, 1.5, 3)]
    bend = random.normal(0, 0.04)
    tilt = Rotation.from_euler("yx", random.uniform(-6, 6, 2), degrees=True)
    up = random.uniform(1.0, 2.2)

    def driven(s: float) -> np.ndarray:
        heading = bend * s
        centre = np.array([0.5 * bend * s * s, -up, s])
        shake = Rotation.from_euler("yxz", random.normal(0, 0.4, 3), degrees=True)
        return _pose(Rotation.from_rotvec([0, heading, 0]) * shake * tilt, centre)

    s = np.cumsum(steps)
    primary = [driven(x) for x in s]
    late = random.uniform(-0.03, 0.03) * speed if random.random() < 0.5 else 0.0
    assistant = [driven(s[k] + late) @ T_p_a for k in (1, 2)]
    poses = np.stack(primary + assistant)
    cameras = [primary_camera] * 4 + [assistant_camera] * 2
    K, lens = (np.stack(part) for part in zip(*cameras, strict=True))
    seconds = np.r_[s, s[1] + late, s[2] + late] / speed
    readout_s = random.uniform(0.008, 0.032, 2) * (random.random(2) < 0.6)
    readout_s = np.repeat(readout_s, (4, 2))
    velocity = speed * np.stack([bend * s, np.zeros(4), np.ones(4)], -1)
    rates = _motion(random, poses[:4], T_p_a, velocity, bend * speed)
    motion = rates * readout_s[:, None]
    arrays = [part.astype(np.float32) for part in (K, lens, poses, motion)]
    optics = [Optics.of(of_view, SIZE) for of_view in zip(*arrays, strict=True)]
    views = [
        render(scene, bank, at, float(t), float(readout))
        for at, t, readout in zip(optics, seconds, readout_s, strict=True)
    ]
    grey = torch.stack([v.grey for v in views]).mul(255).round().byte().cpu().numpy()
    depth = torch.stack([v.depth for v in views]).half().cpu().numpy()
    steady = torch.stack([v.steady for v in views]).cpu().numpy()
    for eye in (slice(0, 4), slice(4, 6)):
        if random.random() < 0.4:
            bonnet = Bonnet.drawn(random, SIZE)
            for view in range(*eye.indices(VIEWS)):
                grey[view] = bonnet.over(grey[view])
            depth[eye, bonnet.covers] = 0
            steady[eye, bonnet.covers] = False
    return Clip(grey, depth, steady, *arrays)


def save_shard(path: Path, clips: list[Clip]) -> None:
    """Write clips as one .npz file."""
    part = path.with_suffix(".part.npz")
    fields = Clip.__dataclass_fields__
    arrays: dict[str, Any] = {n: np.stack([getattr(c, n) for c in clips]) for n in fields}
    np.savez(part, **arrays)
    part.rename(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--textures", type=Path, default=Path("build/textures.npz"))
    parser.add_argument("--out", type=Path, default=Path("build/clips"))
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--first", type=int, default=0, help="number of the first clip, its seed")
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    device = torch.device(arguments.device)
    bank = TextureBank(load(arguments.textures), device)
    began = time.monotonic()
    for first in range(arguments.first, arguments.first + arguments.count, SHARD):
        path = arguments.out / f"{first:06d}.npz"
        if not path.exists():
            seeds = range(first, first + SHARD)
            save_shard(path, [random_clip(np.random.default_rng(s), bank, device) for s in seeds])
            print(f"{path} {time.monotonic() - began:.0f} s", flush=True)


if __name__ == "__main__":
    main()
