"""Interpreter settings of the capture loop."""

from __future__ import annotations

import gc
import sys

from calm_edge.daemon.capture import SWITCH_S, low_latency


def test_low_latency_shortens_thread_switches_and_freezes_old_objects() -> None:
    before = sys.getswitchinterval()
    assert gc.get_freeze_count() == 0
    with low_latency():
        assert abs(sys.getswitchinterval() - SWITCH_S) < 1e-6
        # functions and classes of all modules, some ten thousand objects, are not scanned any more
        assert gc.get_freeze_count() > 10_000
        assert len(gc.get_objects()) < gc.get_freeze_count()
    assert sys.getswitchinterval() == before and gc.get_freeze_count() == 0
