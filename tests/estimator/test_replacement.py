"""All sub-maps placed again beside the live atlas, a few at a time."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bench.scripted import ScriptedBackbone, ScriptedErrors
from calm_edge.config import Config, merge
from calm_edge.estimator.atlas import Atlas
from calm_edge.estimator.localizer import Localizer
from calm_edge.estimator.rectifier import Rectifier
from calm_edge.estimator.replacement import Replacement, Replacements
from calm_edge.estimator.scale import ScaleError
from calm_edge.types import Submap
from tests.drives import T_P_A, curved, scene, windows

CONFIG = merge(
    Config(),
    {
        "scale": {"spacing_m": float(np.linalg.norm(T_P_A[:3, 3]))},
        "correction": {"apply": "never"},
    },
)


@cache
def submaps() -> tuple[Submap, ...]:
    """Sub-maps of a short drive, without an error."""
    localizer = Localizer(CONFIG, ScriptedBackbone(scene(curved(75)), ScriptedErrors()))
    for window in windows(75):
        localizer.process(window)
    return localizer.submaps


def atlas(of: tuple[Submap, ...]) -> Atlas:
    made = Atlas(CONFIG)
    for submap in of:
        made.add(submap)
    return made


def twice_as_long(submap: Submap) -> Submap:
    T_s_c = submap.T_s_c.copy()
    T_s_c[:, :3, 3] *= 2
    return replace(submap, T_s_c=T_s_c, scale=2 * submap.scale)


def path_m(of: Atlas) -> float:
    centres = of.trajectory().T_w_c[:, :3, 3]
    return float(np.linalg.norm(np.diff(centres, axis=0), axis=1).sum())


def test_all_poses_change_at_once_when_the_last_submap_is_placed() -> None:
    live, before = atlas(submaps()), path_m(atlas(submaps()))
    replacement = Replacement(live, live.submaps, twice_as_long)
    done = []
    while not (done and done[-1]):
        assert path_m(live) == before and live.epoch == 0
        done.append(replacement.advance(2))
    assert len(done) == -(-len(submaps()) // 2)
    assert path_m(live) == pytest.approx(2 * before) and live.epoch == 1


def test_submaps_that_come_meanwhile_are_taken_as_they_are() -> None:
    *early, last = submaps()
    live = atlas(tuple(early))
    replacement = Replacement(live, live.submaps, twice_as_long)
    assert not replacement.advance(1)
    live.add(last)
    assert [s.id for s in replacement.sources] == [s.id for s in submaps()]
    assert replacement.advance()
    scales = [s.scale for s in live.submaps]
    assert scales == pytest.approx([2 * s.scale for s in early] + [last.scale])


def test_one_that_cannot_be_rectified_keeps_its_place_and_an_inserted_one_is_left_out() -> None:
    first, second, third, *_ = submaps()

    def failing(submap: Submap) -> Submap:
        if submap.id in (first.id, second.id):
            raise ScaleError("no assistant keyframe")
        return twice_as_long(submap)

    live = atlas((first, third))
    assert Replacement(live, (first, second, third), failing).advance()
    assert [s.id for s in live.submaps] == [first.id, third.id]
    assert [s.scale for s in live.submaps] == pytest.approx([first.scale, 2 * third.scale])


def test_a_replacement_is_due_when_a_tenth_is_new_and_none_is_running() -> None:
    *early, last = submaps()
    live = atlas(tuple(early))
    replacements = Replacements(live, Rectifier(CONFIG, estimates_kit=True))
    assert not replacements.due
    replacements.stale = True
    assert replacements.due
    replacements.begin(live.submaps)
    assert not replacements.stale and not replacements.advance(1)
    replacements.stale = True
    assert not replacements.due
    assert replacements.advance() and not replacements.advance()
    # not again until the drive has grown
    assert not replacements.due
    live.add(last)
    assert replacements.due
