"""Where the joint optimum is computed: here and now, or beside the one who asked.

GTSAM holds the interpreter lock from end to end, so a long graph is optimised in a process of
its own. That one is started as a plain program, not by multiprocessing: the estimator is itself
a daemonic child, which may have no children of its own.
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
    """A graph as it was asked to be optimised; `graph` tells one graph from another."""

    graph: int
    problem: Problem
    state: State


@dataclass(frozen=True, slots=True)
class Solved:
    """The optimum of a snapshot of that graph."""

    graph: int
    optimum: Optimum


class Optimiser(Protocol):
    """Takes snapshots, gives optima. Only the newest request counts."""

    def request(self, snapshot: Snapshot) -> None:
        """Asks for the optimum of a snapshot; replaces a request not yet begun."""

    def poll(self) -> Solved | None:
        """An optimum that has not been given yet, None without one; never waits."""

    def close(self) -> None:
        """Ends what runs and forgets what was asked."""


class Immediate:
    """Computes on request: deterministic, for lockstep and for `map`."""

    def __init__(self) -> None:
        self._solved: Solved | None = None

    def request(self, snapshot: Snapshot) -> None:
        self._solved = Solved(snapshot.graph, optimum(snapshot.problem, snapshot.state))

    def poll(self) -> Solved | None:
        solved, self._solved = self._solved, None
        return solved

    def close(self) -> None:
        self._solved = None


class Spawned:
    """Computes in a process of its own, started at the first request and again if it dies.

    Requests pile up to one: the newest waits while another is worked on.
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
        """Of the process, None while there is none."""
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
                log.warning("the optimiser ended (%s); poses stay until it is asked again", error)
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
    """The process and the two pipes to it; it ends when its end of the pipe closes."""

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
        """Waits for the answer; EOFError or OSError where the process is gone."""
        self._out.send(snapshot)
        solved = self._in.recv()
        assert isinstance(solved, Solved)
        return solved

    def kill(self) -> None:
        """From any thread: a solve that waits fails."""
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()

    def end(self) -> None:
        self._out.close()
        self._in.close()
        self.kill()
        self._process.wait()
