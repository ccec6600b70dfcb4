"""An estimator that was never fast enough."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from unittest.mock import patch

from calm_edge.config import Config
from calm_edge.daemon import estimator_link
from calm_edge.daemon.estimator_process import EstimatorWork, run
from calm_edge.daemon.messages import Processed
from calm_edge.frontend.remembered import REMEMBERED_NS
from calm_edge.types import SubmapWindow

# over the first window as long as the tracker remembers, then longer than a window takes to come
FIRST_S, LATER_S = REMEMBERED_NS / 1e9, 2.0


@contextmanager
def slow_estimator() -> Iterator[None]:
    """Estimators begun inside are slow."""
    with patch.object(estimator_link, "run_estimator", run_slowly):
        yield


def run_slowly(connection: Connection, config: Config, lockstep: bool) -> None:
    """The process's main function."""
    pauses = itertools.chain([FIRST_S], itertools.repeat(LATER_S))
    solve = EstimatorWork._process

    def slowly(work: EstimatorWork, window: SubmapWindow) -> Processed:
        time.sleep(next(pauses))
        return solve(work, window)

    with patch.object(EstimatorWork, "_process", slowly):
        run(connection, config, lockstep)
