"""`python -m calm_edge.posegraph.optimiser_process READ WRITE`: optimises what comes in.

READ, WRITE: file descriptors of pipes. It ends when whoever asks is gone.
"""

from __future__ import annotations

import os
import signal
import sys
from multiprocessing.connection import Connection

from calm_edge.posegraph.optimiser import Snapshot, Solved
from calm_edge.posegraph.optimum import optimum


def serve(requests: Connection, answers: Connection) -> None:
    """Answers every snapshot until either pipe closes."""
    while True:
        try:
            snapshot = requests.recv()
            assert isinstance(snapshot, Snapshot)
            answers.send(Solved(snapshot.graph, optimum(snapshot.problem, snapshot.state)))
            # or it would be held beside the next one
            del snapshot
        except (EOFError, BrokenPipeError):
            return


def main() -> None:
    # whoever asks decides when it ends: Ctrl-C in the terminal is meant for that one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(5)
    read, write = (int(argument) for argument in sys.argv[1:3])
    serve(Connection(read, writable=False), Connection(write, readable=False))


if __name__ == "__main__":
    main()
