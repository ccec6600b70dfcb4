"""The estimator's main function, apart so that capture can name it without loading a solver."""

from __future__ import annotations

from multiprocessing.connection import Connection

from calm_edge.config import Config


def run_estimator(connection: Connection, config: Config, lockstep: bool) -> None:
    """Runs the estimator in the process this is called in."""
    from calm_edge.daemon import estimator_process

    estimator_process.run_estimator(connection, config, lockstep)
