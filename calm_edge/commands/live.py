"""`calm-edge live`: serve a page that shows the running recording."""

from __future__ import annotations

import argparse
import signal
import threading
from pathlib import Path

from calm_edge.commands.console import say
from calm_edge.commands.exit_codes import OK


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("--config", type=Path, metavar="TOML", help="that of the recording")
    parser.add_argument(
        "--socket", type=Path, metavar="PATH", help="where the recording offers its results"
    )
    parser.add_argument(
        "--address",
        default="127.0.0.1:8600",
        metavar="HOST:PORT",
        help="where to serve the page: %(default)s reaches this computer alone, 0.0.0.0:8600 is "
        "all its addresses; beyond this computer a token is required",
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="file that holds the token, made if it is missing; without it each start has another",
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM."""
    from calm_edge.config import load
    from calm_edge.live import access
    from calm_edge.live.board import Board
    from calm_edge.live.server import Server
    from calm_edge.live.socket_path import check_length, default_socket
    from calm_edge.live.source import Source
    from calm_edge.live.wire import Message

    address = access.parse_address(arguments.address)
    token = ""
    if arguments.token_file is not None:
        token = access.token_of(arguments.token_file)
    elif not address.loopback:
        token = access.new_token()
    path = arguments.socket or load(arguments.config).live.socket
    path = Path(path) if path else default_socket()
    check_length(path)
    board: Board[Message] = Board()
    source = Source(path, board)
    server = Server(address, access.Access(token), board, source.ask)
    end = f"?token={token}" if token else ""
    hosts = access.own_addresses() if address.any else [address.host]
    for host in hosts or [address.host]:
        print(f"page        {access.url(host, server.port)}{end}", flush=True)
    if not source.connected:
        say(f"no recording at {path} yet: record --live offers one; the page waits for it")
    serving = threading.Thread(target=server.serve_forever, name="live-server", daemon=True)
    serving.start()
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    stopped.wait()
    server.shutdown()
    source.close()
    server.server_close()
    return OK
