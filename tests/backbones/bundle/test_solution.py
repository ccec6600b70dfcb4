from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import solution
from calm_edge.types import Prediction


def test_a_rejected_solution_is_followed_by_one_from_another_start(monkeypatch):
    starts = ["backwards", "thrown", "right", "unneeded"]
    tried = []

    def solved(start, *rest):
        tried.append(start)
        if start not in mismatch:
            raise BackboneError(f"bundle: {start}")
        return replace(right, overlap_mismatch=mismatch[start])

    right, mismatch = Prediction(cameras=(), T_s_c=np.zeros((0, 4, 4))), {"right": None}
    monkeypatch.setattr(solution, "solved", solved)
    nothing = None, None, None, None
    assert solution.first_sound(starts, *nothing) == right
    assert tried == starts[:3]
    # of several failures the first is reported: that of the best start
    with pytest.raises(BackboneError, match="backwards"):
        solution.first_sound(starts[:2], *nothing)
    # one that agrees with the previous window is preferred; if none does, the best start counts
    mismatch |= {"backwards": 20.0, "thrown": 1.0}
    assert solution.first_sound(starts, *nothing).overlap_mismatch == 1.0
    mismatch |= {"thrown": 9.0, "right": 8.0}
    assert solution.first_sound(starts, *nothing).overlap_mismatch == 20.0
    # unless all contradict it beyond any noise
    mismatch |= dict.fromkeys(starts, 50.0)
    with pytest.raises(BackboneError, match="contradicts the previous window"):
        solution.first_sound(starts, *nothing)
