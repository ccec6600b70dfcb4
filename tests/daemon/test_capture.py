"""The capture loop's own conditions."""

from __future__ import annotations

import gc
import sys

from calm_edge.daemon.capture import SWITCH_S, low_latency


def test_the_loop_waits_neither_for_threads_nor_for_the_collector() -> None:
    before = sys.getswitchinterval()
    assert gc.get_freeze_count() == 0
    with low_latency():
        assert abs(sys.getswitchinterval() - SWITCH_S) < 1e-6
        # the functions and classes of all modules, some ten thousands
        assert gc.get_freeze_count() > 10_000
        assert len(gc.get_objects()) < gc.get_freeze_count()
    assert sys.getswitchinterval() == before and gc.get_freeze_count() == 0
