"""An estimator that is too slow from the start."""

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

# the first window takes as long as the tracker's memory, later ones longer than their period
FIRST_S, LATER_S = REMEMBERED_NS / 1e9, 2.0


@contextmanager
def slow_estimator() -> Iterator[None]:
    """Context in which started estimators are slow."""
    with patch.object(estimator_link, "run_estimator", run_slowly):
        yield


def run_slowly(connection: Connection, config: Config, lockstep: bool) -> None:
    """Main function of the slow process."""
    pauses = itertools.chain([FIRST_S], itertools.repeat(LATER_S))
    solve = EstimatorWork._process

    def slowly(work: EstimatorWork, window: SubmapWindow) -> Processed:
        time.sleep(next(pauses))
        return solve(work, window)

    with patch.object(EstimatorWork, "_process", slowly):
        run(connection, config, lockstep)
