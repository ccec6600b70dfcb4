"""Arguments of the commands that serve a page: on which address, with which token."""

from __future__ import annotations

import argparse
import signal
import threading
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from calm_edge.live.access import Access, Address
    from calm_edge.live.server import Server


def add_address(parser: argparse.ArgumentParser, address: str) -> None:
    """Add the arguments. address: where the page is served unless another is given."""
    port = address.rpartition(":")[2]
    parser.add_argument(
        "--address",
        default=address,
        metavar="HOST:PORT",
        help=f"where to serve the page: %(default)s reaches this computer alone, 0.0.0.0:{port} is "
        "all its addresses; beyond this computer a token is required",
    )
    parser.add_argument(
        "--token-file",
        type=Path,
        metavar="FILE",
        help="file that holds the token, made if it is missing; without it each start has another",
    )


def given_access(arguments: argparse.Namespace, *, always: bool = False) -> tuple[Address, Access]:
    """Address and rules that the arguments give; raises ConfigError.

    always: with a token on the loopback address too, where other users of this computer can open
    a page.
    """
    from calm_edge.live import access

    address = access.parse_address(arguments.address)
    token = ""
    if arguments.token_file is not None:
        token = access.token_of(arguments.token_file)
    elif always or not address.loopback:
        token = access.new_token()
    return address, access.Access(token)


def print_address(address: Address, server: Server) -> None:
    """Print where the page can be opened."""
    from calm_edge.live import access

    token = server.access.token
    end = f"?token={token}" if token else ""
    hosts = access.own_addresses() if address.any else [address.host]
    for host in hosts or [address.host]:
        print(f"page        {access.url(host, server.port)}{end}", flush=True)


def serve(server: Server) -> threading.Event:
    """Serve in a thread; returns an event that SIGINT and SIGTERM set."""
    threading.Thread(target=server.serve_forever, name="page-server", daemon=True).start()
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    return stopped
