"""`calm-edge cameras`: list cameras, and write their addresses to [capture] of a config file."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import ERROR, OK

if TYPE_CHECKING:
    from device.camera import FoundCamera


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--json", action="store_true", help="print everything as one JSON object")
    parser.add_argument(
        "--identify",
        action="store_true",
        help="find out which is which by unplugging one at a time",
    )
    parser.add_argument(
        "--write",
        type=Path,
        metavar="KIT.TOML",
        help="write primary and assistant to [capture] of this file, leaving the rest unchanged",
    )


def run(arguments: argparse.Namespace) -> int:
    """List the cameras; on request, identify them by unplugging and write the config file."""
    from device.camera import discover

    found, errors = discover(details=not arguments.identify)
    for line in errors:
        say(line)
    pair = _identified() if arguments.identify else None
    if arguments.write is not None:
        pair = pair or _first_two(found)
        _write(arguments.write, pair)
    if arguments.json:
        roles = dict(zip(("primary", "assistant"), pair, strict=True)) if pair else {}
        cameras = [dataclasses.asdict(camera) for camera in found]
        print(json.dumps({"cameras": cameras, **roles}, indent=1))
    elif pair:
        print(f'primary = "{pair[0]}"\nassistant = "{pair[1]}"')
    else:
        for camera in found:
            print("\n".join(_lines(camera)))
    if not found:
        if not arguments.json and not errors:
            say("no camera found; plug one in, see: ls /dev/video*")
        return ERROR
    return OK


def _lines(camera: FoundCamera) -> list[str]:
    serial = f"  serial {camera.serial}" if camera.serial else ""
    lines = [f"{camera.address}  {camera.name}  {camera.path}{serial}"]
    lines += [f"    {name}: {', '.join(sizes)}" for name, sizes in camera.formats.items()]
    lines += [f"    {name} = {value}" for name, value in camera.controls.items()]
    return lines + ([f"    {camera.note}"] if camera.note else [])


def _identified() -> tuple[str, str]:
    from calm_edge.commands.identify import IdentifyError, by_unplugging
    from device.camera import discover
    from device.clock import SystemClock

    if not sys.stderr.isatty():
        raise IdentifyError(
            "--identify asks for cameras to be unplugged: run it in a terminal (ssh -t), "
            "or write the addresses that `calm-edge cameras` lists to the config file"
        )

    def addresses() -> set[str]:
        found, _ = discover(details=False)
        return {camera.address for camera in found if not camera.by_name_only}

    return by_unplugging(addresses, SystemClock(), lambda line: print(line, file=sys.stderr))


def _first_two(found: list[FoundCamera]) -> tuple[str, str]:
    from calm_edge.types import CalmEdgeError

    addresses = sorted(camera.address for camera in found if not camera.by_name_only)
    if len(addresses) != 2:
        raise CalmEdgeError(
            f"{len(addresses)} camera(s) found, --write needs two; add --identify to choose"
        )
    first, second = addresses
    say("assumed that the first camera by port is the primary; add --identify to choose")
    return first, second


def _write(path: Path, pair: tuple[str, str]) -> None:
    from calm_edge.commands.config_file import write_keys

    write_keys(path, {"capture": {"primary": pair[0], "assistant": pair[1]}})
    say(f"{path}: wrote primary and assistant to [capture]")
