"""Program of the optimiser's child process: reads snapshots, writes optima.

`python -m calm_edge.posegraph.optimiser_process READ WRITE`, both file descriptors of pipes.
Exits when the parent closes them.
"""

from __future__ import annotations

import os
import sys
from multiprocessing.connection import Connection

from calm_edge.posegraph.optimiser import Snapshot, Solved
from calm_edge.posegraph.optimum import optimum
from calm_edge.processes import follow_parent


def serve(requests: Connection, answers: Connection) -> None:
    """Answer each snapshot with its optimum until either pipe closes."""
    while True:
        try:
            snapshot = requests.recv()
            assert isinstance(snapshot, Snapshot)
            answers.send(Solved(snapshot.graph, optimum(snapshot.problem, snapshot.state)))
            # free it before the next one is received
            del snapshot
        except (EOFError, BrokenPipeError):
            return


def main() -> None:
    follow_parent()
    os.nice(5)
    read, write = (int(argument) for argument in sys.argv[1:3])
    serve(Connection(read, writable=False), Connection(write, readable=False))


if __name__ == "__main__":
    main()
