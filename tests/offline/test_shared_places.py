"""Closures between drives have ids over all drives, world units, and agree with the candidate."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calm_edge.geometry import se3
from calm_edge.loops.finder import LoopCandidate
from calm_edge.offline import shared_places
from calm_edge.offline.shared_places import STRIDE, JoinError, PlacedDrive, closures, drive_of
from calm_edge.types import Float, Keyframe, SubmapWindow
from device.frame import Eye, Frame, jpeg
from tests.offline.test_joined_drives import CONFIG, drive

PICTURE = jpeg(np.zeros((18, 32, 3), np.uint8))
QUERY, VIEW = 2, 3
T_QUERY_PLACE = se3.exp(np.array([0.4, 0.0, -1.5, 0.0, 0.05, 0.0]))


def placed(n: int) -> PlacedDrive:
    """A drive with windows of black pictures."""
    found = drive(n, n)
    windows = {}
    for update in found.drive.updates:
        submap = update.submap
        both = (
            (eye, ids, offset)
            for eye, ids, offset in (
                (Eye.PRIMARY, submap.primary_ids, 0),
                (Eye.ASSISTANT, submap.assistant_ids, submap.n_primary),
            )
        )
        primary, assistant = (
            tuple(
                Keyframe(i, Frame(eye, i, int(submap.t_ns[offset + k]), PICTURE))
                for k, i in enumerate(ids)
            )
            for eye, ids, offset in both
        )
        windows[submap.id] = SubmapWindow(submap.id, primary, assistant, submap.n_overlap)
    found.drive.windows.extend(windows)  # type: ignore[arg-type]
    recording: Any = SimpleNamespace(window=windows.__getitem__)
    return PlacedDrive(recording, found.drive)


class Finder:
    """Finds the first keyframe of the first drive in one window of the second."""

    def __init__(self, *_: Any) -> None:
        self.remembered: list[SubmapWindow] = []

    def find(self, window: SubmapWindow, images: Any, kit: Any) -> LoopCandidate | None:
        assert (kit is None) is (drive_of(window.submap_id) == 0)
        # a drive is compared with the earlier ones, not with itself
        assert {drive_of(w.submap_id) for w in self.remembered} <= {0}
        if window.submap_id != STRIDE + QUERY:
            return None
        approximate = np.array(T_QUERY_PLACE)
        approximate[:3, 3] /= CONFIG.scale.spacing
        return LoopCandidate(VIEW, self.remembered[0].primary[0], approximate)

    def taken(self) -> dict[int, Any]:
        return {}

    def remember(self, window: SubmapWindow, described: Any) -> None:
        self.remembered.append(window)


class Backbone:
    """Places the picture where T_QUERY_PLACE says, or metres beside it; or not at all."""

    def __init__(self, off: float | None) -> None:
        self._off = off

    def locate_view(self, images: Any, hints: Any, prediction: Any, camera: Any) -> Float | None:
        n = len(prediction.cameras)
        assert len(images) == len(hints.eyes) == len(hints.t_ns) == n + 1 and hints.loop
        if self._off is None:
            return None
        T = prediction.T_s_c[VIEW] @ T_QUERY_PLACE
        T[:3, 3] += self._off
        return np.asarray(T)


@pytest.mark.parametrize(("off", "count"), [(0.0, 1), (9.0, 0), (None, 0)])
def test_a_place_is_measured_by_the_window_unless_it_contradicts_the_candidate(
    monkeypatch: pytest.MonkeyPatch, off: float | None, count: int
) -> None:
    monkeypatch.setattr(shared_places, "PlaceLoops", Finder)
    monkeypatch.setattr(shared_places, "open_backbone", lambda config: Backbone(off))
    found = closures([placed(0), placed(1)], CONFIG, lambda line: None)
    assert len(found) == count
    for closure in found:
        ids = placed(1).drive.updates[QUERY].submap.primary_ids
        assert (closure.match_id, closure.query_id) == (0, STRIDE + ids[VIEW])
        np.testing.assert_allclose(se3.inverse(closure.T_match_query), T_QUERY_PLACE, atol=1e-9)


def test_a_backbone_that_cannot_place_pictures_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shared_places, "open_backbone", lambda config: object())
    with pytest.raises(JoinError, match="record with bundle"):
        closures([placed(0), placed(1)], CONFIG, lambda line: None)
