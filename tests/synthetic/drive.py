"""Render a drive of a two-camera kit through the town into a sequence folder.

    python -m tests.synthetic.drive --kit real --out demo/drive

--kit: `real`, two ordinary cameras with their lenses and rolling shutters, a bonnet and other cars;
`plain`, pinholes that expose all rows at once. Writes cam0/NNNNNN.jpg cam1/NNNNNN.jpg, times0.txt
times1.txt (seconds, of the middle rows), poses0.txt poses1.txt (T_world_camera, 12 numbers a row,
metres; world = cam0 at its first frame), calib.txt (fx fy cx cy width height, then the lens's model
and terms if it has some; a camera a row), cloud.npy (float32 (N, 3) points of what stands still,
world), rig.json.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calm_edge.geometry import se3
from calm_edge.geometry.camera import Camera
from calm_edge.geometry.camera_row import camera_row
from tests.synthetic.rows import View
from tests.synthetic.settings import KITS, Settings, camera
from tests.synthetic.shots import Shots, T_primary_assistant, our_drive
from tests.synthetic.textures import Image
from tests.synthetic.world import World, make_world

Float = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Rig:
    """Where both cameras are, exactly: times (N,) s, T_w_c (N, 4, 4) m, cameras; [0], [1].

    Of each picture, when its middle row is exposed.
    """

    times: tuple[Float, Float]
    T_w_c: tuple[Float, Float]
    cameras: tuple[Camera, Camera]


def make_rig(world: World, settings: Settings) -> Rig:
    """The cameras' truth in the town's own frame; fewer frames if the drive ends first."""
    car = our_drive(world, settings)
    t = settings.start_s + np.arange(settings.frames) / settings.rate_hz
    t = t[t + settings.assistant_delay_s <= car.duration_s]
    late = t + settings.assistant_delay_s
    return Rig(
        (t - settings.start_s, late - settings.start_s),
        (car.poses(t), car.poses(late) @ T_primary_assistant(settings)),
        (camera(settings, 0), camera(settings, 1)),
    )


def exposed(
    image: Image, t: float, rng: np.random.Generator, settings: Settings, eye: int = 0
) -> Image:
    """The picture through a lens, with slow exposure drift and sensor noise."""
    phase = settings.seed + settings.exposure_phase[eye]
    drift = np.sin(0.31 * t + phase) + 0.4 * np.sin(0.97 * t)
    gain = settings.gain[eye] * (1 + settings.exposure_drift * drift)
    noise = settings.noise * rng.standard_normal(image.shape, np.float32)
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), settings.lens_blur_px)
    return np.asarray(np.clip(soft * np.float32(gain) + noise + 0.5, 0, 255), np.uint8)


def _thinned(points: Float, voxel: float) -> Float:
    """One point a voxel, the first one in."""
    cells = np.floor(points / voxel).astype(np.int64) + 2**20
    code = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return np.asarray(points[np.sort(np.unique(code, return_index=True)[1])])


def _still_points(view: View, lens: Camera, T_w_rows: Float, reach_m: float) -> Float:
    """World points (N, 3) of a view's pixels of still surfaces nearer than reach_m.

    T_w_rows: (H, 4, 4) of its rows.
    """
    row, column = np.nonzero((view.part == 0) & (view.depth > 0) & (view.depth < reach_m))
    pixels = np.stack([column, row], -1).astype(np.float64)
    p_c = lens.back_project(pixels, view.depth[row, column].astype(np.float64))
    T = T_w_rows[row]
    return np.asarray((T[:, :3, :3] @ p_c[..., None])[..., 0] + T[:, :3, 3])


def write_sequence(folder: Path, world: World, settings: Settings, *, talk: bool = False) -> Rig:
    """Render and write a whole sequence folder; returns its truth with world = first primary."""
    town, shots = make_rig(world, settings), Shots(world, settings)
    T_w_town = se3.inverse(town.T_w_c[0][0])
    rig = Rig(town.times, (T_w_town @ town.T_w_c[0], T_w_town @ town.T_w_c[1]), town.cameras)
    cloud = np.zeros((0, 3))
    quality = [cv2.IMWRITE_JPEG_QUALITY, settings.jpeg_quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    for eye in (0, 1):
        (folder / f"cam{eye}").mkdir(parents=True, exist_ok=True)
        for i, t in enumerate(rig.times[eye]):
            view = shots.view(eye, settings.start_s + t)
            rng = np.random.default_rng([settings.seed, 71, eye, i])
            ok, jpeg = cv2.imencode(".jpg", exposed(view.image, t, rng, settings, eye), quality)
            assert ok
            (folder / f"cam{eye}" / f"{i:06d}.jpg").write_bytes(jpeg.tobytes())
            if eye == 0 and i % settings.cloud_every == 0:
                T = T_w_town @ shots.poses(eye, shots.row_times(eye, settings.start_s + t))
                new = _still_points(view, rig.cameras[eye], T, settings.cloud_reach_m)
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
    (folder / "calib.txt").write_text("".join(f"{camera_row(c)}\n" for c in rig.cameras))
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
    parser = argparse.ArgumentParser(description="Render the demo drive.")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kit", choices=sorted(KITS), default="real")
    for name in ("frames", "width", "height", "seed", "jpeg-quality"):
        parser.add_argument(f"--{name}", type=int)
    for name in ("start-s", "noise", "density", "rate-hz", "assistant-delay-s"):
        parser.add_argument(f"--{name}", type=float)
    values = vars(parser.parse_args(arguments))
    folder, kit = values.pop("out"), KITS[values.pop("kit")]
    settings = replace(kit, **{k: v for k, v in values.items() if v is not None})
    world = make_world(settings.seed, settings.density)
    write_sequence(folder, world, settings, talk=True)


if __name__ == "__main__":
    main()
