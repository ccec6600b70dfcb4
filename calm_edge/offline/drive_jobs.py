"""Run one command for each of several drives: in processes of this computer, or on a Dask cluster.

A command reads and writes files alone, so that it can be run anywhere that has them, and again. One
whose process was killed is run once more.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from calm_edge.processes import CHILD_ENVIRONMENT
from calm_edge.types import CalmEdgeError

# how often a drive is done again whose worker was lost
RETRIES = 2
CONNECT_S = 10


class JobError(CalmEdgeError):
    """Jobs cannot be run."""


class KilledError(Exception):
    """The process of a command was killed."""


def here(commands: Sequence[Sequence[str]], workers: int | None = None) -> Iterator[int]:
    """Run the commands on this computer; yield their exit codes in order.

    workers: how many at a time; None: one for two cores, since each has workers of its own.
    """
    cores = len(os.sched_getaffinity(0))
    with ThreadPoolExecutor(workers or max(1, cores // 2)) as pool:
        yield from pool.map(_again, commands)


def _again(command: Sequence[str]) -> int:
    for attempt in range(1 + RETRIES):
        try:
            return run(command)
        except KilledError:
            if attempt == RETRIES:
                return 1
    raise AssertionError


def on_dask(commands: Sequence[Sequence[str]], address: str) -> Iterator[int]:
    """Run the commands on the cluster of a Dask scheduler; yield their exit codes in order.

    Its workers need calm-edge and the same files under the same names. The job of a worker that is
    lost is run again by another. Raises JobError.
    """
    try:
        from distributed import Client
    except ImportError:
        raise JobError(
            "distributed: not installed; --dask needs it (pip install 'calm-edge[dask]')"
        ) from None
    try:
        client: Any = Client(address, timeout=CONNECT_S)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise JobError(f"--dask {address}: no scheduler there ({error})") from None
    with client:
        # a job is a program of its own, which a pure function of its arguments is not
        jobs = [client.submit(run, list(c), retries=RETRIES, pure=False) for c in commands]
        for job in jobs:
            try:
                yield int(job.result())
            except KilledError:
                yield 1
            except Exception as error:
                raise JobError(f"--dask {address}: a job failed ({error})") from None


def run(command: Sequence[str]) -> int:
    """Run one command; return its exit code. Raises KilledError if it was killed."""
    code = subprocess.run(
        [sys.executable, *command], env={**os.environ, **CHILD_ENVIRONMENT}, check=False
    ).returncode
    if code < 0:
        raise KilledError(f"{' '.join(command)}: killed by signal {-code}")
    return code
