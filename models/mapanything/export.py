"""Export MapAnything, with images as only input, to a model folder.

    python models/mapanything/export.py --repo map-anything --dinov2 dinov2 \
        --config config.json --checkpoint model.safetensors --license-file LICENSE

--repo: a checkout of facebookresearch/map-anything, with `pip install --no-deps uniception`.
--dinov2: a checkout of facebookresearch/dinov2, for the encoder's code. --config: config.json with
the constructor's arguments, published beside the weights.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from exporting import command
from exporting.graph import Network

NORMALISATION = "dinov2"


class AllViewsAtOnce(torch.nn.Module):
    """The authors' layers applied to all views as one tensor.

    Their forward takes a list of views, whose length would become a constant of the graph.
    `Original` is the reference for parity.
    """

    def __init__(self, net: torch.nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, ...]:
        from uniception.models.encoders import ViTEncoderInput

        net = self.net
        shape = images.shape[-2:]
        seen = net.encoder(ViTEncoderInput(image=images[0], data_norm_type=NORMALISATION))
        fused = net.fusion_norm_layer(seen.features.permute(0, 2, 3, 1)).permute(0, 3, 1, 2)
        tokens = fused.flatten(2)
        if net.use_register_tokens_from_encoder and seen.registers is not None:
            tokens = torch.cat([tokens, seen.registers], 2)
        layers, scale_token = self.shared(tokens.transpose(1, 2))
        grid = fused.shape[-2:]
        maps = [each[:, : grid[0] * grid[1]].transpose(1, 2).unflatten(2, grid) for each in layers]
        if net.use_encoder_features_for_dpt:
            maps.insert(0, fused)
        dense, pose, scale = net.downstream_head(maps, scale_token, shape)
        rays, along = dense.value.permute(0, 2, 3, 1).split([3, 1], -1)
        place, quaternion = pose.value.split([3, 4], -1)
        poses = torch.cat([place * scale, quaternion], -1)
        confidence = dense.confidence.permute(0, 2, 3, 1)
        return poses[None], rays[None], (along * scale[..., None, None])[None], confidence[None]

    def shared(self, tokens: torch.Tensor) -> tuple[list[torch.Tensor], torch.Tensor]:
        """Apply the layers that alternate between attention over all views and within each view.

        tokens: (N, T, C). Returns the features (N, T, C') that the heads use, by layer, and the
        scale token (1, C', 1).
        """
        sharing = self.net.info_sharing
        views, count, _ = tokens.shape
        every = torch.cat([tokens.flatten(0, 1)[None], self.net.scale_token[None, None]], 1)
        every = sharing.proj_embed(every)
        if sharing.distinguish_ref_and_non_ref_views:
            first = every[:, :count] + sharing.view_pos_table[0]
            every = torch.cat([first, every[:, count:]], 1)
        taken = []
        for index, block in enumerate(sharing.self_attention_blocks):
            if index % 2 == 0:
                every = block(every, None)
            else:
                each = block(every[0, :-1].unflatten(0, (views, count)), None)
                every = torch.cat([each.flatten(0, 1)[None], every[:, -1:]], 1)
            if index in sharing.indices:
                taken.append(sharing.norm(every) if sharing.norm_intermediate else every)
        taken.append(sharing.norm(every))
        layers = [each[0, :-1].unflatten(0, (views, count)) for each in taken]
        return layers, taken[-1][:, -1:].transpose(1, 2)


class Original(torch.nn.Module):
    """The authors' forward on a list of views."""

    def __init__(self, net: torch.nn.Module) -> None:
        super().__init__()
        self.net = net

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, ...]:
        views = self.net([{"img": v[None], "data_norm_type": [NORMALISATION]} for v in images[0]])
        poses = [torch.cat([v["cam_trans"], v["cam_quats"]], -1) for v in views]
        maps = [[v[name] for v in views] for name in ("ray_directions", "depth_along_ray", "conf")]
        rays, along, confidence = (torch.cat(each)[None] for each in maps)
        return torch.cat(poses)[None], rays, along, confidence[..., None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--dinov2", type=Path, required=True, help="checkout of its code")
    parser.add_argument("--config", type=Path, help="config.json of the weights")


def build(args: argparse.Namespace) -> Network:
    """Create the network on the CPU, with the checkpoint's weights or random ones."""
    from mapanything.models.mapanything.model import MapAnything

    torch.hub.load = _from_checkout(args.dinov2)
    if args.config:
        config = json.loads(args.config.read_text())
    elif args.random_weights:
        config = published(args.repo / "configs" / "model")
    else:
        raise SystemExit("--config: missing; give the config.json published with the checkpoint")
    if args.small:
        _shrink(config)
    net = MapAnything(**config)
    for part in net.modules():
        # the exporter does not support clamp with an integer and a float limit
        for limit in {"vmin", "vmax"} & set(vars(part)):
            setattr(part, limit, float(getattr(part, limit)))
    command.load(net, args)
    return Network(
        AllViewsAtOnce(net), ("poses", "rays", "depth_along_ray", "conf"), original=Original(net)
    )


def published(folder: Path) -> dict[str, Any]:
    """The constructor's arguments, read from the authors' configuration files."""
    from omegaconf import OmegaConf

    OmegaConf.register_new_resolver("special_float", float, replace=True)

    def read(*names: str) -> Any:
        return OmegaConf.merge(*(OmegaConf.load(folder / f"{name}.yaml") for name in names))

    head = read("pred_head/dpt_pose_scale")
    adaptor = "raydirs_depth_pose_confidence_mask_scale"
    head.adaptor_config = read(f"pred_head/adaptor_config/{adaptor}")
    parts = {
        "encoder": read("encoder/dinov2_giant_24_layers"),
        "info_sharing": read("info_sharing/aat_ifr_16_layers_vitg_dim"),
        "pred_head": head,
        "task": read("task/default", "task/images_only"),
    }
    # merge, since unpacking would resolve references between the files before all are present
    whole = OmegaConf.merge({"model": parts}, {"model": read("mapanything")})
    config: dict[str, Any] = OmegaConf.to_container(whole.model.model_config, resolve=True)
    return config


def _shrink(config: dict[str, Any]) -> None:
    config["encoder_config"] |= {"size": "small", "keep_first_n_layers": 6}
    config["info_sharing_config"]["module_args"] |= {
        "dim": 384,
        "num_heads": 6,
        "depth": 6,
        "indices": [2, 4],
    }


def _from_checkout(folder: Path) -> Any:
    """Replacement for torch.hub.load that takes the encoder's code from a checkout, no weights."""
    load = torch.hub.load

    def local(repo: str, model: str, **given: Any) -> Any:
        return load(str(folder), model, source="local", pretrained=False)

    return local


if __name__ == "__main__":
    command.main(__doc__, Path(__file__).parent, build, add_arguments)
