"""`calm-edge doctor`: list what is there and what is missing, a line each with the remedy."""

from __future__ import annotations

import argparse
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.configuration import add_set
from calm_edge.commands.exit_codes import ERROR, OK

if TYPE_CHECKING:
    from calm_edge.commands.finding import Finding
    from calm_edge.config import Config

# of the package for the car
SERVICE_CONFIG = Path("/etc/calm-edge/calm-edge.toml")
SERVICE_ROOT = Path("/var/lib/calm-edge")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--config",
        type=Path,
        metavar="TOML",
        help=f"configuration to check (default: {SERVICE_CONFIG}, if it is there)",
    )
    add_set(parser)
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder of recordings, checked for space and unfinished drives "
        f"(default: {SERVICE_ROOT} with the service's configuration, else the current folder)",
    )
    parser.add_argument(
        "--measure",
        action="store_true",
        help="measure the speed with the model, half a minute or more; otherwise the last "
        "measurement is shown",
    )
    parser.add_argument("--json", action="store_true", help="the findings as JSON")


def run(arguments: argparse.Namespace) -> int:
    """Print a line for each finding."""
    from calm_edge.commands.finding import Level, print_lines
    from calm_edge.config import load

    file = arguments.config or (SERVICE_CONFIG if SERVICE_CONFIG.is_file() else None)
    config = load(file, arguments.set)
    of_service = arguments.config is None and file is not None
    out = arguments.out or (SERVICE_ROOT if of_service else Path())
    lines = findings(config, out, measure=arguments.measure)
    found = list(lines) if arguments.json else print_lines(lines)
    count = {level: sum(f.level is level for f in found) for level in Level}
    if arguments.json:
        table = [dataclasses.asdict(finding) for finding in found]
        print(json.dumps({"works": not count[Level.BAD], "findings": table}, indent=1))
    else:
        print(f"{count[Level.GOOD]} ok, {count[Level.NOTE]} notes, {count[Level.BAD]} failures")
    return ERROR if count[Level.BAD] else OK


def findings(config: Config, out: Path, *, measure: bool = False) -> Iterator[Finding]:
    """Yield everything that is checked, in the order of a first set-up."""
    from calm_edge.commands import installation, plugged_in, surroundings
    from device.camera import discover

    yield from installation.findings(config)
    state = surroundings.service_state()
    yield from speed_findings(config, state.active == "active", measure=measure)
    yield from plugged_in.cameras(config, *discover(details=False))
    yield from plugged_in.permissions(config)
    yield plugged_in.serial(config)
    yield plugged_in.gps(config)
    yield from surroundings.disk(config, out)
    yield from surroundings.unfinished(out)
    yield surroundings.clock()
    yield surroundings.heat(config)
    yield surroundings.service(state)


def speed_findings(config: Config, is_recording: bool, *, measure: bool) -> Iterator[Finding]:
    """Yield the speed with the model. is_recording: the computer is busy, nothing is measured."""
    from calm_edge.commands.finding import note
    from calm_edge.commands.installation import NEEDED, installed

    if not all(map(installed, NEEDED)):
        return
    from calm_edge.commands import speed
    from calm_edge.types import CalmEdgeError

    try:
        found = None if measure and not is_recording else speed.stored(config)
        if measure and is_recording:
            yield note(speed.NAME, "not measured: the service records", "stop it before")
        elif measure:
            found = speed.measure(config)
        if found is not None:
            yield found.finding()
        elif not measure:
            yield note(speed.NAME, "not measured on this computer", "calm-edge doctor --measure")
    except CalmEdgeError as error:
        yield note(speed.NAME, f"not measured: {error}")
