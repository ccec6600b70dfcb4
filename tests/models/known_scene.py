"""Export a published network with random weights whose outputs are right for one known scene.

    python tests/models/known_scene.py NAME --pictures FOLDER [options of export.py]

All weights are random, but the last layers are fitted by ridge regression so that the raw outputs
on windows of that scene have the meaning documented by the authors. This tests exporter, decoder
and `model check` on the real architecture without published weights.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "models"))
from exporting import command
from exporting.graph import Network
from exporting.pictures import normalised

from calm_edge.backbones.onnx.model_folder import EXPORTED
from tests.backbones.feedforward.decode.test_decoder import quaternion
from tests.backbones.raw_scene import RawScene, turn

SIZE = (56, 42)
VIEWS = 6
# windows to fit: those of golden values and parity, and the two parts of a split window
WINDOWS = (range(2), range(3), range(6), range(4), range(2, 6))
RIDGE = 1e-4
# iterations of VGGT's camera head, whose outputs are summed
ROUNDS = 4
SPECS: dict[str, dict[str, Any]] = {
    "vggt": {},
    "pi3": {},
    "da3": {"mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225]},
    "mapanything": {"mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225]},
}


def scene() -> RawScene:
    """Six views that move towards a slanted plane, about 10 units away, and turn slightly."""
    width, height = SIZE
    K = np.array([[50.0, 0, (width - 1) / 2], [0, 48.0, (height - 1) / 2], [0, 0, 1]])
    T_w_c = np.tile(np.eye(4), (VIEWS, 1, 1))
    for view in range(VIEWS):
        T_w_c[view, :3, :3] = turn(1, 3.0 * view) @ turn(0, 1.0 * view)
        T_w_c[view, :3, 3] = 0.06 * view, 0.01 * view, 0.12 * view
    return RawScene(np.stack([K] * VIEWS), T_w_c, [SIZE] * VIEWS, np.array([0.3, 0.2, 1.0]), 1.4)


def paint(folder: Path) -> NDArray[np.uint8]:
    """Write the views as PNG: BGR (N, H, W, 3), depth in green, a pattern fixed to the plane."""
    seen, (width, height) = scene(), SIZE
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    folder.mkdir(parents=True, exist_ok=True)
    images = []
    for view in range(VIEWS):
        z, T = seen.z(view, u, v), seen.T_w_c[view]
        p = seen.ray(view, u, v) * z[..., None] @ T[:3, :3].T + T[:3, 3]
        pattern = 0.5 + 0.2 * np.sin(9 * p[..., 0]) + 0.2 * np.sin(11 * p[..., 1])
        image = (np.stack([pattern, z / 3, 1 - pattern], -1) * 255).clip(0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{view}.png"), image)
        images.append(image)
    return np.stack(images)


def targets(name: str, window: Sequence[int]) -> list[NDArray[np.float64]]:
    """Outputs (rows, channels) that each layer of `layers` must have on a window.

    In the frame of the first view and the order of calls, before the network's exp, normalisation
    or ReLU.
    """
    seen, (width, height) = scene(), SIZE
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    ray = np.stack([seen.ray(i, u, v) for i in window])
    z = np.stack([seen.z(i, u, v) for i in window])[..., None]
    T = np.linalg.inv(seen.T_w_c[window[0]]) @ seen.T_w_c[list(window)]
    place, turned = T[:, :3, 3], T[:, :3, :3]
    quaternions = np.array([quaternion(R) for R in turned])
    length = np.linalg.norm(ray, axis=-1, keepdims=True)
    fov = 2 * np.arctan([height / 2 / seen.K[0, 1, 1], width / 2 / seen.K[0, 0, 0]])
    fovs = np.tile(fov, (len(window), 1))
    if name == "da3":
        return [place, quaternions, fovs, np.log(z).reshape(-1, 1)]
    if name == "vggt":
        T = np.linalg.inv(T)
        quaternions = np.array([quaternion(R) for R in T[:, :3, :3]])
        whole = np.concatenate([T[:, :3, 3], quaternions, fovs], 1)
        return [np.tile(whole / ROUNDS, (ROUNDS, 1)), np.log(z).reshape(-1, 1)]
    if name == "pi3":
        maps = torch.from_numpy(np.concatenate([ray[..., :2], np.log(z)], -1))
        patches = nn.functional.pixel_unshuffle(maps.permute(0, 3, 1, 2), 14)
        tokens = patches.flatten(2).transpose(1, 2).flatten(0, 1).numpy()
        return [tokens, place, turned.reshape(-1, 9)]
    maps = np.concatenate([ray / length, np.log(z * length)], -1).reshape(-1, 4)
    return [maps, place, quaternions, np.zeros((1, 1))]


def layers(name: str, net: nn.Module) -> list[nn.Module]:
    """The last layers of a network, in the order of `targets`."""
    if name == "da3":
        decoder = net.cam_dec
        dense = net.head.scratch.output_conv2[2]
        return [decoder.fc_t, decoder.fc_qvec, decoder.fc_fov[0], dense]
    if name == "vggt":
        return [net.camera_head.pose_branch.fc2, net.depth_head.scratch.output_conv2[2]]
    if name == "pi3":
        return [net.point_head.proj, net.camera_head.fc_t, net.camera_head.fc_rot]
    pose = net.pose_head
    return [net.dpt_regressor_head.conv2[2], pose.fc_t, pose.fc_rot, net.scale_head.output_proj]


def solve(name: str, network: Network, shown: NDArray[np.uint8]) -> None:
    """Set the last layers' weights; outputs without a target keep theirs."""
    last = layers(name, network.module.net)
    rows: list[list[NDArray[np.float64]]] = [[] for _ in last]
    wanted: list[list[NDArray[np.float64]]] = [[] for _ in last]
    for window in WINDOWS:
        asked = targets(name, window)
        hooks = [
            layer.register_forward_hook(_keeper(*each))
            for layer, *each in zip(last, rows, asked, strict=True)
        ]
        with torch.no_grad():
            network.module(torch.from_numpy(normalised(shown[list(window)], SPECS[name])))
        for hook, values, target in zip(hooks, wanted, asked, strict=True):
            hook.remove()
            values.append(target)
    for layer, inputs, outputs in zip(last, rows, wanted, strict=True):
        _regress(layer, np.concatenate(inputs), np.concatenate(outputs))


def _keeper(rows: list[NDArray[np.float64]], target: NDArray[np.float64]) -> Any:
    """A forward hook that stores a layer's inputs.

    A linear layer returns its target already, because a repeated call depends on its output.
    """
    left = target

    def keep(layer: nn.Module, given: tuple[torch.Tensor], out: torch.Tensor) -> Any:
        nonlocal left
        if isinstance(layer, nn.Conv2d):
            value = given[0].permute(0, 2, 3, 1)
            rows.append(value.reshape(-1, value.shape[-1]).double().numpy())
            return None
        value = given[0].reshape(-1, given[0].shape[-1])
        rows.append(value.double().numpy())
        now, left = left[: len(value)], left[len(value) :]
        return torch.from_numpy(now).to(out.dtype).reshape(out.shape)

    return keep


def _regress(layer: Any, x: NDArray[np.float64], y: NDArray[np.float64]) -> None:
    mean_x, mean_y = x.mean(0), y.mean(0)
    a = x - mean_x
    gram = a.T @ a
    gram[np.diag_indices(len(gram))] += RIDGE * np.trace(gram) / len(gram)
    weight = np.linalg.solve(gram, a.T @ (y - mean_y)).T
    known = y.shape[1]
    with torch.no_grad():
        layer.weight[:known] = torch.from_numpy(weight).reshape(layer.weight[:known].shape)
        layer.bias[:known] = torch.from_numpy(mean_y - weight @ mean_x)


def main(name: str, argv: list[str]) -> None:
    """Run a model's export.py with the last layers of its network fitted to the scene."""
    here = EXPORTED / name
    spec = importlib.util.spec_from_file_location(f"{name}_export", here / "export.py")
    assert spec is not None and spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)

    def build(args: Any) -> Network:
        network = script.build(args)
        network.module.eval()
        solve(name, network, paint(args.pictures))
        return network

    more = getattr(script, "add_arguments", lambda parser: None)
    command.main(__doc__, here, build, more, ["--random-weights", "--size", "56x42", *argv])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
