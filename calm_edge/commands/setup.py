"""`calm-edge setup`: describe two cameras in a configuration file, checking each step."""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.configuration import metres
from calm_edge.commands.doctor import SERVICE_CONFIG
from calm_edge.commands.exit_codes import ERROR, LOSS, OK

if TYPE_CHECKING:
    from calm_edge.commands.dialogue import Dialogue

KIT = Path("kit.toml")


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument(
        "--config",
        type=Path,
        metavar="TOML",
        help="file to write; what it has besides is kept (default: "
        f"{SERVICE_CONFIG} if it is there, else {KIT})",
    )
    parser.add_argument("--primary", metavar="ADDRESS", help="camera whose path is the trajectory")
    parser.add_argument("--assistant", metavar="ADDRESS", help="the second camera")
    parser.add_argument(
        "--cover", action="store_true", help="find the primary by covering its lens"
    )
    parser.add_argument(
        "--spacing-m", type=metres, metavar="X", help="distance of the lenses [m], by tape"
    )
    parser.add_argument(
        "--port", metavar="PORT", help="serial port or udp:HOST:PORT to send poses on, or none"
    )
    parser.add_argument("--gps", metavar="SOURCE", help="serial port of a receiver, gpsd, or none")
    parser.add_argument(
        "--picture", type=Path, metavar="JPG", help="write both pictures side by side to this file"
    )
    parser.add_argument(
        "--no-speed", action="store_true", help="do not measure the speed of this computer"
    )
    parser.add_argument(
        "--start", action="store_true", help="with --yes: enable and start the installed service"
    )
    parser.add_argument(
        "--yes", action="store_true", help="ask nothing: options and proposals are the answers"
    )
    parser.add_argument(
        "--sequence",
        type=Path,
        metavar="FOLDER",
        help="try it without cameras, on cam0/ cam1/ of a folder; no address is written",
    )


def run(arguments: argparse.Namespace) -> int:
    """Go through the steps; the file is written at the end."""
    from calm_edge.commands.configuration import check
    from calm_edge.commands.dialogue import opened
    from calm_edge.commands.finding import Level
    from calm_edge.commands.surroundings import service_state
    from calm_edge.commands.wizard import Wizard
    from calm_edge.config import Config, load, merge

    if arguments.spacing_m is not None:
        check(merge(Config(), {"scale": {"spacing_m": arguments.spacing_m}}))
    dialogue = opened(yes=arguments.yes)
    path = arguments.config or (SERVICE_CONFIG if SERVICE_CONFIG.is_file() else KIT)
    wizard = Wizard(dialogue, load(path if path.exists() else None))
    primary, assistant = arguments.primary, arguments.assistant
    if arguments.sequence is None and not wizard.choose_cameras(primary, assistant):
        return ERROR
    found = wizard.look(
        arguments.sequence,
        is_chosen=bool(primary or assistant),
        cover=arguments.cover,
        picture=arguments.picture,
    )
    wizard.spacing(arguments.spacing_m)
    wizard.serial_ports(arguments.port, arguments.gps)
    service = service_state()
    if not arguments.no_speed:
        wizard.speed(service.active == "active")
    if not wizard.write(path):
        dialogue.say("nothing was written")
        return ERROR
    if path == SERVICE_CONFIG and service.installed:
        _start(dialogue, wanted=arguments.start)
    else:
        name = shlex.quote(str(path))
        dialogue.say(f"to record: calm-edge record --config {name} --out drives/1")
    return LOSS if any(finding.level is Level.BAD for finding in found) else OK


def _start(dialogue: Dialogue, *, wanted: bool) -> None:
    """Enable the service and start it with the new configuration, if wanted."""
    from calm_edge.commands.surroundings import UNIT

    command = f"systemctl enable {UNIT} && systemctl restart {UNIT}"
    if not dialogue.silent:
        wanted = dialogue.confirm("Start the service now and at each boot", True)
    if wanted and run_as_root(command):
        dialogue.say("started; to watch it: systemctl status calm-edge")
    else:
        dialogue.say(f"to start it: sudo sh -c {shlex.quote(command)}")


def run_as_root(command: str) -> bool:
    """Run a shell command, with sudo for other users; whether it succeeded."""
    words = ["sh", "-c", command] if os.geteuid() == 0 else ["sudo", "sh", "-c", command]
    try:
        return subprocess.run(words, check=False).returncode == 0
    except OSError:
        return False
