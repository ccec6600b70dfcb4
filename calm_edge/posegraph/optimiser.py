"""Optimisers of the joint graph: in the calling process, or in a separate one.

GTSAM holds the interpreter lock (GIL) during the whole optimisation, so during a drive it runs in a
separate process. That is started with `subprocess`, since the estimator is a daemonic process of
`multiprocessing`, which may not have children of that module.
"""

from __future__ import annotations

import contextlib
import logging
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol

from calm_edge.posegraph.optimum import Optimum, optimum
from calm_edge.posegraph.problem import Problem, State
from calm_edge.processes import CHILD_ENVIRONMENT

log = logging.getLogger(__name__)

_PROGRAM = "calm_edge.posegraph.optimiser_process"
_CLOSE_S = 5.0


@dataclass(frozen=True, slots=True)
class Snapshot:
    """Problem and initial state of a graph at the time of a request. graph: id of the graph."""

    graph: int
    problem: Problem
    state: State


@dataclass(frozen=True, slots=True)
class Solved:
    """Optimum of a snapshot. graph: id of the graph it was taken from."""

    graph: int
    optimum: Optimum


class Optimiser(Protocol):
    """Computes optima of snapshots; a newer request replaces one that waits."""

    def request(self, snapshot: Snapshot) -> None:
        """Request the optimum of a snapshot. Replaces a request that has not started."""

    def poll(self) -> Solved | None:
        """Return the newest optimum once, None without a new one."""

    def close(self) -> None:
        """Stop a running optimisation and drop pending requests."""


class Immediate:
    """Optimiser that computes in `poll`: deterministic, for lockstep and for `map`."""

    def __init__(self) -> None:
        self._waiting: Snapshot | None = None

    def request(self, snapshot: Snapshot) -> None:
        self._waiting = snapshot

    def poll(self) -> Solved | None:
        snapshot, self._waiting = self._waiting, None
        if snapshot is None:
            return None
        return Solved(snapshot.graph, optimum(snapshot.problem, snapshot.state))

    def close(self) -> None:
        self._waiting = None


class Spawned:
    """Optimiser in a child process, started at the first request and restarted if it dies.

    `poll` does not block. Of the requests made during a computation, only the newest is kept.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: Snapshot | None = None
        self._solved: Solved | None = None
        self._closed = False
        self._child: _Child | None = None
        self._thread: threading.Thread | None = None

    @property
    def pid(self) -> int | None:
        """Process id of the child, None while there is none."""
        child = self._child
        return child.pid if child else None

    def request(self, snapshot: Snapshot) -> None:
        with self._changed:
            if self._closed:
                return
            self._waiting = snapshot
            self._changed.notify()
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="optimiser", daemon=True)
            self._thread.start()

    def poll(self) -> Solved | None:
        with self._changed:
            solved, self._solved = self._solved, None
        return solved

    def close(self) -> None:
        with self._changed:
            self._closed, self._waiting = True, None
            self._changed.notify()
            child = self._child
        if child is not None:
            child.kill()
        if self._thread is not None:
            self._thread.join(_CLOSE_S)

    def _work(self) -> None:
        while (snapshot := self._next()) is not None:
            child = self._child
            try:
                if child is None:
                    child = self._start()
                solved = child.solve(snapshot)
            except (EOFError, OSError) as error:
                self._discard(child)
                log.warning("the optimiser process died (%s); it restarts when next needed", error)
                continue
            with self._changed:
                self._solved = solved
        self._discard(self._child)

    def _next(self) -> Snapshot | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._waiting is not None)
            snapshot, self._waiting = self._waiting, None
            return snapshot

    def _start(self) -> _Child:
        child = _Child()
        with self._changed:
            self._child = child
            if self._closed:
                child.kill()
        return child

    def _discard(self, child: _Child | None) -> None:
        with self._changed:
            self._child = None
        if child is not None:
            child.end()


class _Child:
    """The child process and the two pipes to it. It exits when the pipes close."""

    def __init__(self) -> None:
        their_in, our_out = os.pipe()
        our_in, their_out = os.pipe()
        path = os.pathsep.join(entry or str(Path.cwd()) for entry in sys.path)
        self._process = subprocess.Popen(
            [sys.executable, "-m", _PROGRAM, str(their_in), str(their_out)],
            pass_fds=(their_in, their_out),
            stdin=subprocess.DEVNULL,
            env={**os.environ, **CHILD_ENVIRONMENT, "PYTHONPATH": path},
        )
        os.close(their_in)
        os.close(their_out)
        self._out = Connection(our_out, readable=False)
        self._in = Connection(our_in, writable=False)
        self.pid = self._process.pid

    def solve(self, snapshot: Snapshot) -> Solved:
        """Send a snapshot and wait for its optimum. EOFError or OSError if the process died."""
        self._out.send(snapshot)
        solved = self._in.recv()
        assert isinstance(solved, Solved)
        return solved

    def kill(self) -> None:
        """Kill the process, from any thread; a waiting `solve` raises."""
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()

    def end(self) -> None:
        self._out.close()
        self._in.close()
        self.kill()
        self._process.wait()
