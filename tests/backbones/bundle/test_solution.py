from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from calm_edge.backbones.base import BackboneError
from calm_edge.backbones.bundle import solution
from calm_edge.kit import layout
from calm_edge.types import Prediction


def test_a_rejected_solution_is_followed_by_one_from_another_start(monkeypatch):
    starts = ["backwards", "thrown", "right", "unneeded"]
    tried, theta = [], layout.prior((None, None)).mean

    def states(names):
        return [SimpleNamespace(name=name, theta=theta) for name in names]

    def solved(state, *rest):
        start = state.name
        tried.append(start)
        if start not in mismatch:
            raise BackboneError(f"bundle: {start}")
        return replace(right, overlap_mismatch=mismatch[start])

    right, mismatch = Prediction(cameras=(), T_s_c=np.zeros((0, 4, 4))), {"right": None}
    monkeypatch.setattr(solution, "solved", solved)
    nothing = None, None, {layout.PERSPECTIVE: None}, None
    assert solution.first_sound(states(starts), *nothing) == right
    assert tried == starts[:3]
    # of several failures the first is reported: that of the best start
    with pytest.raises(BackboneError, match="backwards"):
        solution.first_sound(states(starts[:2]), *nothing)
    # one that agrees with the previous window is preferred; if none does, the best start counts
    mismatch |= {"backwards": 20.0, "thrown": 1.0}
    assert solution.first_sound(states(starts), *nothing).overlap_mismatch == 1.0
    mismatch |= {"thrown": 9.0, "right": 8.0}
    assert solution.first_sound(states(starts), *nothing).overlap_mismatch == 20.0
    # unless all contradict it beyond any noise
    mismatch |= dict.fromkeys(starts, 50.0)
    with pytest.raises(BackboneError, match="contradicts the previous window"):
        solution.first_sound(states(starts), *nothing)
