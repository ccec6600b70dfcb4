"""`calm-edge config`: print the configuration as commented TOML."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from calm_edge.commands.configuration import add_configuration, given_config
from calm_edge.commands.exit_codes import OK


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "recording",
        type=Path,
        nargs="?",
        metavar="REC",
        help="a recording: begin with the configuration it was made with, not with the defaults",
    )
    parser.add_argument(
        "--changed", action="store_true", help="only keys that differ from their default"
    )
    parser.add_argument("--json", action="store_true", help="all values as one JSON object")
    add_configuration(parser)


def run(arguments: argparse.Namespace) -> int:
    """Print the configuration that `record` would use with the same options.

    Files it names are not read, and what is `auto` is left so. Raises ConfigError, BackboneError or
    CameraError for what `record` would refuse before it opens a device.
    """
    from calm_edge.backbones.onnx.precision import pinned
    from calm_edge.commands.config_text import commented
    from calm_edge.daemon import ladder, source
    from calm_edge.kit.given_mask import masks_of
    from calm_edge.pose_output.line_budget import check_rate
    from calm_edge.recording.reader import Recording
    from calm_edge.recording.room import check_settings

    base = None if arguments.recording is None else Recording(arguments.recording).config
    config = given_config(arguments, base)
    source.live(config)
    check_settings(config.recording)
    ladder.check(config.degrade)
    masks_of(config.capture)
    check_rate(config.pose_output, limited=False)
    pinned(config, deterministic=False)
    if arguments.json:
        print(json.dumps(config.to_dict(), indent=1))
    else:
        print(commented(config, changed_only=arguments.changed), end="")
    return OK
