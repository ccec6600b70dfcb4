"""A small working model for tests, with images that encode the scene in their colours.

Red encodes the camera's lateral position, blue its forward position, green the depth of each
pixel. The graph averages these and divides lengths by the distance travelled over all views, so
that each view's result depends on all views. `expected` computes the same in numpy.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
from onnx import parser, save_model

from calm_edge.types import Bytes, Float

RANGE = 16.0
FAR = 20.0
FOV = (0.9, 1.4)
SIZE = (128, 64)
INPUT_SIZE = (64, 32)
# the scene: plane normal . p = distance; all views have the axes of the world
NORMAL, DISTANCE = np.array([0.3, 0.2, 1.0]), 14.0

GRAPH = """
<ir_version: 9, opset_import: ["" : 17]>
painted (float[N,3,H,W] image) => (float[N,9] pose, float[N,1,H,W] depth, float[N,1,H,W] conf)
<float[3,3] take = {TAKE, 0, 0, 0, 0, 0, 0, 0, TAKE}, float[3] origin = {ORIGIN, 0, 0},
 float[3,1] along = {0, 0, TAKE}, float[1] four = {4}, float[3,6] none = {ZEROS},
 float[6] rest = {0, 0, 0, 1, FOV0, FOV1}, float[1,3,1,1] green = {0, FAR, 0},
 float[1,3,1,1] red = {-3, 0, 0}, float[1] one = {1}, int64[1] views = {0}, float[1] half = {0.5}>
{
  mean = ReduceMean<axes = [2, 3], keepdims = 0>(image)
  place = MatMul(mean, take)
  centre = Add(place, origin)
  depth_of_all = MatMul(mean, along)
  come = Add(depth_of_all, four)
  SCALE
  scaled = Div(centre, scale)
  to_camera = Neg(scaled)
  no_turn = MatMul(mean, none)
  turn_and_fov = Add(no_turn, rest)
  pose = Concat<axis = 1>(to_camera, turn_and_fov)
  smooth = AveragePool<kernel_shape = [3, 3], pads = [1, 1, 1, 1]>(image)
  far = Conv(smooth, green)
  all = ReduceMean<axes = [0, 1], keepdims = 0>(come)
  depth = Div(far, all)
  weak = Conv(smooth, red)
  power = Exp(weak)
  conf = Add(power, one)
}
"""
RIGHT = "scale = ReduceMean<axes = [0], keepdims = 1>(come)"
# as left by an export traced at two views: the number of views is a constant
FROZEN = "sum = ReduceSum<keepdims = 1>(come, views) scale = Mul(sum, half)"
MANIFEST = """
format = 1
name = "painted"
kind = "feedforward"
license = "none needed"
[graphs.model]
inputs = ["image"]
{variants}
[input]
name = "image"
layout = "NCHW"
channels = "rgb"
resize = "width"
size_px = 64
multiple = 8
[frames]
min = 1
max = {max_views}
dynamic = true
[output.pose]
name = "pose"
encoding = "t_quatxyzw_fovhw"
direction = "world_to_camera"
[output.intrinsics]
encoding = "fov"
[output.geometry]
name = "depth"
encoding = "z_depth"
[output.confidence]
name = "conf"
encoding = "expp1"
[golden]
sha256 = "{golden}"
"""


def graph_text(*, frozen: bool = False, drift: float = 0.0) -> str:
    """The graph. frozen: right for two views only. drift: relative error of distances."""
    values = {
        "TAKE": RANGE * (1 + drift),
        "ORIGIN": -RANGE / 2 * (1 + drift),
        "ZEROS": ", ".join(["0"] * 18),
        "FOV0": FOV[0],
        "FOV1": FOV[1],
        "FAR": FAR * (1 + drift),
        "SCALE": FROZEN if frozen else RIGHT,
    }
    text = GRAPH
    for name, value in values.items():
        text = text.replace(name, str(value))
    return text


def paint(centres: Float, size: tuple[int, int] = SIZE, seed: int = 0) -> list[Bytes]:
    """Images (H, W, 3), uint8 BGR, of the plane from centres (N, 3): y = 0, |x| < 8, z in 0..12.

    Rounding is random, so that means and neighbourhoods keep more than eight bits.
    """
    rng = np.random.default_rng(seed)
    width, height = size
    # rays through the pixel centres of an image with field of view FOV in both axes
    u = np.tan(FOV[1] / 2) * ((np.arange(width) + 0.5) / width * 2 - 1)
    v = np.tan(FOV[0] / 2) * ((np.arange(height) + 0.5) / height * 2 - 1)
    rays = np.stack([*np.meshgrid(u, v), np.ones((height, width))], -1)
    images = []
    for x, _, z in centres:
        depth = (DISTANCE - NORMAL @ [x, 0, z]) / (rays @ NORMAL)
        colours = [np.full(depth.shape, z / RANGE), depth / FAR, np.full(depth.shape, 0.5 + x / 16)]
        levels = np.stack(colours, -1) * 255
        images.append(np.floor(levels + rng.random(levels.shape)).clip(0, 255).astype(np.uint8))
    return images


def expected(pictures: Bytes) -> dict[str, Float]:
    """Outputs of the correct graph for BGR images (N, h, w, 3) of the input's size."""
    rgb = pictures[..., ::-1].astype(np.float64) / 255
    mean = rgb.mean((1, 2))
    centre = RANGE * np.stack([mean[:, 0] - 0.5, 0 * mean[:, 0], mean[:, 2]], -1)
    scale = (RANGE * mean[:, 2] + 4).mean()
    rest = np.tile([0, 0, 0, 1, *FOV], (len(rgb), 1))
    padded = np.pad(rgb, ((0, 0), (1, 1), (1, 1), (0, 0)))
    count = np.pad(np.ones(rgb.shape[1:3]), 1)
    h, w = rgb.shape[1:3]
    boxes = [(slice(i, i + h), slice(j, j + w)) for i in range(3) for j in range(3)]
    smooth = sum(padded[:, r, c] for r, c in boxes) / sum(count[r, c] for r, c in boxes)[..., None]
    return {
        "pose": np.concatenate([-centre / scale, rest], 1),
        "depth": FAR * smooth[:, None, ..., 1] / scale,
        "conf": 1 + np.exp(-3 * smooth[:, None, ..., 0]),
    }


def centres(n: int) -> Float:
    """Centres (2 n, 3): n primary ones moving forward, then the assistant's 0.5 to the right."""
    z = 0.8 * np.arange(n)
    primary = np.stack([0 * z, 0 * z, z], -1)
    return np.concatenate([primary, primary + np.array([0.5, 0, 0])])


def write_model(
    folder: Path,
    *,
    frozen: bool = False,
    drift_int8: float | None = None,
    max_views: int = 24,
    cases: tuple[int, ...] = (2, 4),
) -> Path:
    """Write a model folder with golden values at the numbers of views `cases`; returns it."""
    folder.mkdir(parents=True, exist_ok=True)
    drifts = {"fp32": 0.0} | ({} if drift_int8 is None else {"int8": drift_int8})
    variants = []
    for precision, drift in drifts.items():
        file = folder / f"{precision}.onnx"
        save_model(parser.parse_model(graph_text(frozen=frozen, drift=drift)), file)
        variants.append(f'{precision} = {{ file = "{file.name}", sha256 = "{sha256(file)}" }}')
    arrays = {}
    for n in cases:
        pictures = np.stack(paint(centres(-(-n // 2))[:n], INPUT_SIZE, seed=n))
        arrays[f"model/n{n}/pictures"] = pictures
        arrays |= {f"model/n{n}/out/{k}": v for k, v in expected(pictures).items()}
    np.savez_compressed(folder / "golden.npz", **arrays)
    (folder / "LICENSE").write_text("Anyone may do anything with it.\n")
    text = MANIFEST.format(
        variants="\n".join(variants), max_views=max_views, golden=sha256(folder / "golden.npz")
    )
    (folder / "manifest.toml").write_text(text)
    return folder


def sha256(path: Path) -> str:
    """sha256 of a file in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
