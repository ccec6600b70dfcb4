"""`calm-edge live`: serve a page that shows the running recording."""

from __future__ import annotations

import argparse
from pathlib import Path

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import OK
from calm_edge.commands.page_address import add_address, given_access, print_address, serve


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--config", type=Path, metavar="TOML", help="that of the recording")
    parser.add_argument(
        "--socket", type=Path, metavar="PATH", help="where the recording offers its results"
    )
    add_address(parser, "127.0.0.1:8600")


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM."""
    from calm_edge.config import load
    from calm_edge.live.board import Board
    from calm_edge.live.server import Server, live_page
    from calm_edge.live.socket_path import check_length, default_socket
    from calm_edge.live.source import Source
    from calm_edge.live.wire import Message

    address, access = given_access(arguments)
    path = arguments.socket or load(arguments.config).live.socket
    path = Path(path) if path else default_socket()
    check_length(path)
    board: Board[Message] = Board()
    source = Source(path, board)
    server = Server(address, access, live_page(), board, source.ask)
    print_address(address, server)
    if not source.connected:
        say(f"no recording at {path} yet: record --live offers one; the page waits for it")
    serve(server).wait()
    source.close()
    server.close()
    return OK
