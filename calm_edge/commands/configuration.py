"""Arguments of the commands that set the configuration, and the configuration they give."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.console import say

if TYPE_CHECKING:
    from calm_edge.config import Config

# limits of what can be meant; beyond them, centimetres or radians were given
SPACING_M = 0.01, 10.0
MIN_HFOV_DEG = 4.0


def add_configuration(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that `effective_config` reads."""
    parser.add_argument("--config", type=Path, metavar="TOML", help="configuration file of the kit")
    parser.add_argument(
        "--spacing-m", type=metres, metavar="X", help="distance between the cameras [m]"
    )
    parser.add_argument(
        "--hfov-deg",
        type=float,
        nargs="+",
        metavar="A",
        help="horizontal field of view, one value or one per camera: an optional hint",
    )
    parser.add_argument(
        "--calibration",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="known calibration (OpenCV, ROS, Kalibr, COLMAP): one file, or one per camera",
    )
    add_set(parser)


def add_set(parser: argparse.ArgumentParser) -> None:
    """Add the argument that overrides keys of the configuration."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="override the configuration",
    )


def metres(text: str) -> float:
    """Number of metres of an argument; raises argparse.ArgumentTypeError."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no number; give metres, such as 0.52"
        ) from None


def given_config(arguments: argparse.Namespace, base: Config | None = None) -> Config:
    """Merge `base`, file, --set and the other options; later ones override earlier ones.

    base: the defaults if None. Files that the configuration names are not read. Raises ConfigError.
    """
    from calm_edge.config import ConfigError, load, merge

    config = load(arguments.config, arguments.set, base)
    if arguments.spacing_m is not None:
        config = merge(config, {"scale": {"spacing_m": arguments.spacing_m}})
    if arguments.hfov_deg is not None:
        if len(arguments.hfov_deg) > 2:
            raise ConfigError("--hfov-deg: give one value or one per camera")
        config = merge(config, {"backbone": {"hfov_deg": arguments.hfov_deg}})
    if arguments.calibration is not None:
        config = merge(config, {"calibration": {"file": [str(f) for f in arguments.calibration]}})
    check(config)
    return config


def effective_config(arguments: argparse.Namespace, base: Config | None = None) -> Config:
    """`given_config`, with calibration files and masks read into it.

    base: the defaults if None; its calibration is not read again. If precision or views per run of
    a model are `auto`, they are chosen for this computer. Raises ConfigError, BackboneError,
    CalibrationError.
    """
    from calm_edge.backbones.onnx.precision import pinned
    from calm_edge.commands.calibration_file import with_calibration
    from calm_edge.commands.mask_file import with_masks

    config = given_config(arguments, base)
    recorded = base.calibration.file if base is not None else ()
    if config.calibration.file and (arguments.calibration or config.calibration.file != recorded):
        config = with_calibration(config, say)
    masks = base.capture.mask if base is not None else ()
    if config.capture.mask != masks:
        config = with_masks(config)
    # a calibration may have given the spacing
    check(config)
    return pinned(config, deterministic=arguments.pace == "lockstep")


def check(config: Config) -> None:
    """Raise ConfigError for values that cannot be meant."""
    from calm_edge.config import ConfigError

    spacing_m = config.scale.spacing_m
    if spacing_m and not SPACING_M[0] <= spacing_m <= SPACING_M[1]:
        raise ConfigError(
            f"scale.spacing_m = {spacing_m:g}: the distance of two cameras of one car in metres, "
            f"{SPACING_M[0]:g} to {SPACING_M[1]:g}; 52 cm are 0.52"
        )
    if config.gps.source and config.gps.source == config.pose_output.port:
        raise ConfigError(f"gps.source = {config.gps.source}: is pose_output.port as well")
    readout_ms = config.capture.readout_ms
    if len(readout_ms) > 2 or any(not 0 <= ms < 200 for ms in readout_ms):
        raise ConfigError(
            f"capture.readout_ms = {list(readout_ms)}: give one value or one per camera, 0 to 200"
        )
    if any(not MIN_HFOV_DEG <= a < 180 for a in config.backbone.hfov_deg):
        raise ConfigError(
            f"backbone.hfov_deg = {list(config.backbone.hfov_deg)}: degrees, {MIN_HFOV_DEG:g} to "
            "less than 180"
        )
