"""The capture loop's own conditions."""

from __future__ import annotations

import gc
import sys

from calm_edge.daemon.capture import SWITCH_S, prompt


def test_the_loop_waits_neither_for_threads_nor_for_what_was_there_before_it() -> None:
    before = sys.getswitchinterval()
    assert gc.get_freeze_count() == 0
    with prompt():
        assert abs(sys.getswitchinterval() - SWITCH_S) < 1e-6
        # all modules' functions and classes, some ten thousands, are looked through no more
        assert gc.get_freeze_count() > 10_000
        assert len(gc.get_objects()) < gc.get_freeze_count()
    assert sys.getswitchinterval() == before and gc.get_freeze_count() == 0
