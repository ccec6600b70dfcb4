"""`calm-edge setup`: describe two cameras in a configuration file, checking each step."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from calm_edge.commands.configuration import metres
from calm_edge.commands.console import say
from calm_edge.commands.doctor import SERVICE_CONFIG
from calm_edge.commands.exit_codes import ERROR, LOSS, OK
from calm_edge.commands.page_address import add_address, given_access, print_address, serve
from calm_edge.commands.service_start import BY_HAND, COMMAND, record_command, run_as_root

if TYPE_CHECKING:
    from calm_edge.commands.dialogue import Dialogue
    from calm_edge.commands.finding import Finding
    from calm_edge.commands.setup_choices import Choices

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
    parser.add_argument(
        "--page", action="store_true", help="set up on a page in a browser instead of here"
    )
    add_address(parser, "127.0.0.1:8601")


def run(arguments: argparse.Namespace) -> int:
    """Go through the steps, here or on a page; the file is written at the end."""
    from calm_edge.commands.configuration import check
    from calm_edge.commands.setup_choices import Choices
    from calm_edge.config import Config, load, merge

    if arguments.spacing_m is not None:
        check(merge(Config(), {"scale": {"spacing_m": arguments.spacing_m}}))
    path = arguments.config or (SERVICE_CONFIG if SERVICE_CONFIG.is_file() else KIT)
    choices = Choices(load(path if path.exists() else None))
    steps = _on_page if arguments.page else _in_terminal
    return steps(arguments, choices, path)


def _in_terminal(arguments: argparse.Namespace, choices: Choices, path: Path) -> int:
    from calm_edge.commands.dialogue import opened
    from calm_edge.commands.surroundings import service_state
    from calm_edge.commands.wizard import Wizard

    dialogue = opened(yes=arguments.yes)
    wizard = Wizard(dialogue, choices)
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
        dialogue.say(f"to record: {record_command(path)}")
    return _code(found)


def _on_page(arguments: argparse.Namespace, choices: Choices, path: Path) -> int:
    """Serve the page until it finishes, or until SIGINT or SIGTERM."""
    from calm_edge.commands.setup_page import SetupPage
    from calm_edge.commands.surroundings import service_state
    from calm_edge.config import ConfigError
    from calm_edge.live.board import Board
    from calm_edge.live.server import Page, Server, page_files
    from calm_edge.live.wire import Message

    for option in ("yes", "cover", "picture", "start"):
        if getattr(arguments, option):
            raise ConfigError(f"--page with --{option}: the page has that; leave one out")
    if arguments.spacing_m is not None:
        choices.set_spacing(arguments.spacing_m)
    port, receiver = arguments.port, arguments.gps
    if port is not None or receiver is not None:
        base = choices.base
        choices.set_ports(
            base.pose_output.port if port is None else port,
            base.gps.source if receiver is None else receiver,
        )
    board: Board[Message] = Board()
    page = SetupPage(
        choices,
        path,
        board,
        sequence=arguments.sequence,
        given=(arguments.primary, arguments.assistant),
        startable=path == SERVICE_CONFIG and service_state().installed,
    )
    files = page_files("calm_edge.commands", "setup_files")
    # it writes a file and may start a service: not for other users of this computer
    address, access = given_access(arguments, always=True)
    content = Page(files, page.requests, "calm-edge setup")
    server = Server(address, access, content, board, page.ask)
    print_address(address, server)
    page.run(serve(server))
    server.close()
    if not page.written:
        say("nothing was written")
        return ERROR
    say(f"wrote {path}; to record: {record_command(path)}")
    return _code(page.findings)


def _code(found: Iterable[Finding]) -> int:
    from calm_edge.commands.finding import Level

    return LOSS if any(finding.level is Level.BAD for finding in found) else OK


def _start(dialogue: Dialogue, *, wanted: bool) -> None:
    """Enable the service and start it with the new configuration, if wanted."""
    if not dialogue.silent:
        wanted = dialogue.confirm("Start the service now and at each boot", True)
    if wanted and run_as_root(COMMAND, ask=True):
        dialogue.say("started; to watch it: systemctl status calm-edge")
    else:
        dialogue.say(f"to start it: {BY_HAND}")
