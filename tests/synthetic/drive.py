"""Render a drive of the two-camera kit through the town into a sequence folder.

    python -m tests.synthetic.drive --out demo/drive

Writes cam0/NNNNNN.jpg cam1/NNNNNN.jpg, times0.txt times1.txt (seconds), poses0.txt poses1.txt
(T_world_camera, 12 numbers a row, metres; world = cam0 at its first frame), calib.txt (fx fy cx cy
width height, a camera a row), cloud.npy (float32 (N, 3) surface points, world), rig.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera, Perspective
from tests.synthetic.path import Drive
from tests.synthetic.render import render_view
from tests.synthetic.textures import Image
from tests.synthetic.world import World, make_world

Float = NDArray[np.float64]
Float32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Settings:
    """Everything that decides a drive. Lengths m, angles degrees, times s, density texels/m.

    rotation_deg: rotation vector of the assistant in the primary's axes (pitch, yaw, roll).
    offset_m: its optical centre there, stretched to `spacing_m`. overlap_m: how much of the
    first street is driven again at the end.
    """

    frames: int = 440
    width: int = 544
    height: int = 208
    seed: int = 0
    rate_hz: float = 10.0
    start_s: float = 0.0
    hfov_deg: tuple[float, float] = (78.0, 70.0)
    rotation_deg: tuple[float, float, float] = (1.2, -3.5, -1.5)
    offset_m: tuple[float, float, float] = (0.497, 0.018, 0.045)
    spacing_m: float = 0.5
    assistant_delay_s: float = 0.017
    lens_blur_px: float = 0.65
    noise: float = 2.0
    exposure_drift: float = 0.07
    jpeg_quality: int = 85
    density: float = 48.0
    overlap_m: float = 32.0
    cloud_every: int = 4
    cloud_reach_m: float = 40.0
    cloud_voxel_m: float = 0.15
    cloud_points: int = 110_000


@dataclass(frozen=True, slots=True)
class Rig:
    """Where both cameras are, exactly: times (N,) s, T_w_c (N, 4, 4) m, cameras; [0], [1]."""

    times: tuple[Float, Float]
    T_w_c: tuple[Float, Float]
    cameras: tuple[Camera, Camera]


def T_primary_assistant(settings: Settings) -> Float:
    """(4, 4) assistant -> primary, metres."""
    offset = np.array(settings.offset_m)
    offset *= settings.spacing_m / np.linalg.norm(offset)
    return se3.compose(se3.so3_exp(np.radians(settings.rotation_deg)), offset)


def make_rig(world: World, settings: Settings) -> Rig:
    """The cameras' truth in the town's own frame; fewer frames if the drive ends first."""
    step = float(np.linalg.norm(world.loop[1] - world.loop[0]))
    again = world.loop[: round(settings.overlap_m / step)]
    car = Drive(np.concatenate([world.loop, again]), settings.seed)
    t = settings.start_s + np.arange(settings.frames) / settings.rate_hz
    t = t[t + settings.assistant_delay_s <= car.duration_s]
    late = t + settings.assistant_delay_s
    size = settings.width, settings.height
    T_p_a = T_primary_assistant(settings)
    return Rig(
        (t - settings.start_s, late - settings.start_s),
        (car.poses(t), car.poses(late) @ T_p_a),
        (
            Perspective.from_hfov(settings.hfov_deg[0], *size),
            Perspective.from_hfov(settings.hfov_deg[1], *size),
        ),
    )


def exposed(image: Image, t: float, rng: np.random.Generator, settings: Settings) -> Image:
    """The picture through a lens, with slow exposure drift and sensor noise."""
    drift = np.sin(0.31 * t + settings.seed) + 0.4 * np.sin(0.97 * t)
    gain = 1 + settings.exposure_drift * drift
    noise = settings.noise * rng.standard_normal(image.shape, np.float32)
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), settings.lens_blur_px)
    return np.asarray(np.clip(soft * np.float32(gain) + noise + 0.5, 0, 255), np.uint8)


def _thinned(points: Float, voxel: float) -> Float:
    """One point a voxel, the first one in."""
    cells = np.floor(points / voxel).astype(np.int64) + 2**20
    code = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return np.asarray(points[np.sort(np.unique(code, return_index=True)[1])])


def _surface_points(depth: Float32, camera: Camera, T_w_c: Float, reach_m: float) -> Float:
    """World points (N, 3) of a depth map's pixels nearer than reach_m."""
    row, column = np.nonzero((depth > 0) & (depth < reach_m))
    pixels = np.stack([column, row], -1).astype(np.float64)
    p_c = camera.back_project(pixels, depth[row, column].astype(np.float64))
    return se3.transform(T_w_c, p_c)


def write_sequence(folder: Path, world: World, settings: Settings, *, talk: bool = False) -> Rig:
    """Render and write a whole sequence folder; returns its truth with world = first primary."""
    town = make_rig(world, settings)
    T_w_town = se3.inverse(town.T_w_c[0][0])
    rig = Rig(town.times, (T_w_town @ town.T_w_c[0], T_w_town @ town.T_w_c[1]), town.cameras)
    cloud = np.zeros((0, 3))
    for eye in (0, 1):
        (folder / f"cam{eye}").mkdir(parents=True, exist_ok=True)
        for i, (t, T) in enumerate(zip(town.times[eye], town.T_w_c[eye], strict=True)):
            image, depth = render_view(world.scene, T, town.cameras[eye])
            rng = np.random.default_rng([settings.seed, 71, eye, i])
            ok, jpeg = cv2.imencode(
                ".jpg",
                exposed(image, t, rng, settings),
                [
                    cv2.IMWRITE_JPEG_QUALITY,
                    settings.jpeg_quality,
                    cv2.IMWRITE_JPEG_OPTIMIZE,
                    1,
                ],
            )
            assert ok
            (folder / f"cam{eye}" / f"{i:06d}.jpg").write_bytes(jpeg.tobytes())
            if eye == 0 and i % settings.cloud_every == 0:
                new = _surface_points(
                    depth, rig.cameras[0], rig.T_w_c[0][i], settings.cloud_reach_m
                )
                cloud = _thinned(np.concatenate([cloud, new]), settings.cloud_voxel_m)
            if talk and i % 50 == 0:
                print(f"cam{eye} {i} of {len(town.times[eye])}", file=sys.stderr)
        times = "".join(f"{t:.6f}\n" for t in rig.times[eye])
        (folder / f"times{eye}.txt").write_text(times)
        rows = rig.T_w_c[eye][:, :3].reshape(-1, 12)
        text = "".join(" ".join(f"{v:.9g}" for v in row) + "\n" for row in rows)
        (folder / f"poses{eye}.txt").write_text(text)
    if len(cloud) > settings.cloud_points:
        pick = np.random.default_rng([settings.seed, 73]).permutation(len(cloud))
        cloud = cloud[np.sort(pick[: settings.cloud_points])]
    np.save(folder / "cloud.npy", cloud.astype(np.float32))
    optics = ((c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in rig.cameras)
    lines = (" ".join(f"{value:.9g}" for value in row) for row in optics)
    (folder / "calib.txt").write_text("".join(f"{line}\n" for line in lines))
    notes = {"settings": asdict(settings), "T_p_a": T_primary_assistant(settings).tolist()}
    (folder / "rig.json").write_text(json.dumps(notes, indent=1) + "\n")
    return rig


def make_sequence(
    folder: Path,
    n_frames: int = 20,
    width: int = 320,
    height: int = 128,
    seed: int = 0,
    *,
    start_s: float = 0.0,
    density: float = 14.0,
    world: World | None = None,
) -> Rig:
    """A small sequence folder for tests, in seconds; returns its truth.

    start_s: where on the drive to begin (a turn starts at about 6 s). world: to share one
    town between calls (its density then wins).
    """
    settings = Settings(
        frames=n_frames, width=width, height=height, seed=seed, start_s=start_s, density=density
    )
    return write_sequence(folder, world or make_world(seed, density), settings)


def main(arguments: list[str] | None = None) -> None:
    """The command line."""
    default = Settings()
    parser = argparse.ArgumentParser(description="Render the demo drive.")
    parser.add_argument("--out", type=Path, required=True)
    for name in ("frames", "width", "height", "seed", "jpeg-quality"):
        key = name.replace("-", "_")
        parser.add_argument(f"--{name}", type=int, default=getattr(default, key))
    for name in ("start-s", "noise", "density", "rate-hz", "assistant-delay-s"):
        key = name.replace("-", "_")
        parser.add_argument(f"--{name}", type=float, default=getattr(default, key))
    values = vars(parser.parse_args(arguments))
    folder = values.pop("out")
    settings = Settings(**values)
    world = make_world(settings.seed, settings.density)
    write_sequence(folder, world, settings, talk=True)


if __name__ == "__main__":
    main()
