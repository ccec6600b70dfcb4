"""The tracker's main function, apart so that capture can name it without loading the tracker."""

from __future__ import annotations

from multiprocessing.connection import Connection

from calm_edge.config import FrontendConfig
from calm_edge.daemon.messages import Counters


def run_tracker(
    connection: Connection, ring_name: str, slot_bytes: int, config: FrontendConfig, start: Counters
) -> None:
    """Runs the tracker in the process this is called in."""
    from calm_edge.daemon import tracker_process

    tracker_process.run_tracker(connection, ring_name, slot_bytes, config, start)
