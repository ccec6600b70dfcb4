"""Chaining places the recording's sub-maps by the matches logged with them."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench import chained as module
from bench.chained import chained, matched_submaps
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.results import compare
from calm_edge.evaluation.truth import Truth
from calm_edge.types import Landmarks, LocalizerUpdate, Metre, Prediction, Trajectory
from device.frame import Eye, Frame
from tests.bench.baselines import chains
from tests.evaluation.worlds import curve

N = 40
DRIVE = chains.drive(curve(N))
FRAME = Frame(Eye.PRIMARY, 0, 0, np.zeros((320, 640, 3), np.uint8))


def landmarks(k: int) -> Landmarks:
    """Forty points a common picture, seen by both sub-maps at the same pixels."""
    points, view, uv = [], [], []
    for other in (k - 1, k + 1):
        if not 0 <= other < len(DRIVE.submaps):
            continue
        ids = DRIVE.submaps[k].primary_ids
        for frame in set(ids) & set(DRIVE.submaps[other].primary_ids):
            p_w = DRIVE.points(max(k, other), 40)
            points.append(chains.moved(DRIVE.T_s_w[k], p_w))
            view.append(np.full(40, ids.index(frame)))
            uv.append(np.stack([np.arange(40) * 15.0, np.arange(40) * 7.0], 1))
    joined = np.concatenate(points)
    where = np.concatenate(uv).astype(np.float32)
    return Landmarks(joined, np.arange(len(joined)), np.concatenate(view), where)


def update(k: int) -> LocalizerUpdate:
    submap = DRIVE.submaps[k]
    prediction = Prediction(submap.cameras_raw, submap.T_s_c_raw, landmarks=landmarks(k))
    trajectory = Trajectory(np.arange(1), np.zeros(1, np.int64), np.eye(4)[None], np.eye(4), k)
    return LocalizerUpdate(submap, prediction, trajectory, metre=Metre(0.01))


UPDATES = [update(k) for k in range(len(DRIVE.submaps))]


class Recording:
    """The attributes of a recording that are read."""

    kept: list[LocalizerUpdate] = UPDATES

    def __init__(self, _path: Path) -> None:
        pass

    def updates(self) -> Iterator[LocalizerUpdate]:
        return iter(self.kept)

    def frames(self, _eye: Eye) -> Iterator[Frame]:
        return iter([FRAME])


@pytest.fixture
def recording(monkeypatch: pytest.MonkeyPatch) -> type[Recording]:
    fresh = type("Fresh", (Recording,), {"kept": UPDATES})
    monkeypatch.setattr(module, "Recording", fresh)
    return fresh


@pytest.mark.parametrize("alignment", ["sim3", "sl4"])
def test_exact_matches_chain_to_the_truth(recording: type[Recording], alignment: str) -> None:
    estimate = chained(Path("r"), alignment)
    assert estimate.submaps == len(DRIVE.submaps) and len(estimate.t_ns) == N
    truth = Truth(np.arange(N, dtype=np.int64) * 100_000_000, curve(N))
    figures = compare(replace(estimate, first_frame=None), truth, "se3")
    assert figures["poses"] == N
    # the first sub-map's scale makes its unit the world's
    assert figures["ate_se3_m"] < 1e-3
    assert estimate.first_frame == (0, 0)


def test_an_update_without_matches_leaves_the_one_that_had_them() -> None:
    bare = replace(UPDATES[0], prediction=replace(UPDATES[0].prediction, landmarks=None))
    again = replace(UPDATES[1], stage_ms={"infer": 1.0})
    kept = matched_submaps([*UPDATES, bare, again])
    assert [u.submap.id for u in kept] == list(range(len(UPDATES)))
    assert kept[0] is UPDATES[0] and kept[1] is again


def test_a_broken_chain_says_why(recording: type[Recording]) -> None:
    blind = replace(UPDATES[1].prediction, landmarks=landmarks(0))
    recording.kept = [UPDATES[0], replace(UPDATES[1], prediction=blind)]
    with pytest.raises(EvaluationError, match=r"Sim\(3\) chaining: \S+"):
        chained(Path("r"), "sim3")


def test_nothing_to_chain_is_named(recording: type[Recording]) -> None:
    recording.kept = []
    with pytest.raises(EvaluationError, match=r"^r: no sub-map with landmarks"):
        chained(Path("r"), "sim3")
