"""Steps between keyframes: garbage is counted where the product claims a measurement."""

from dataclasses import replace

import numpy as np
import pytest

from bench.keyframe_steps import garbage_share, judged, within_submap
from calm_edge.config import Config
from calm_edge.evaluation import EvaluationError
from calm_edge.evaluation.truth import Truth
from calm_edge.recording.window_record import WindowRecord
from calm_edge.recording.writer import RecordingWriter
from tests.evaluation.worlds import curve, stamps, update


def test_garbage_is_counted_after_one_scale_for_the_drive():
    true = np.full(10, 2.0)
    step = 0.5 * true
    step[3] *= 1.3
    assert garbage_share(step, true) == pytest.approx(0.1)


def test_steps_at_standstill_are_not_judged():
    true = np.array([2.0, 2.0, 2.0, 0.001])
    assert garbage_share(np.array([2.0, 2.0, 2.0, 0.5]), true) == 0
    assert garbage_share(np.array([0.5]), np.array([0.0])) == 0


def test_a_step_across_a_bridge_is_no_measurement():
    ids = np.array([0, 1, 2, 7, 8])
    assert within_submap(ids, [(0, 1, 2), (7, 8)]).tolist() == [True, True, False, True]
    assert within_submap(ids[:1], [(0, 1)]).tolist() == []


def _window(submap_id, ids):
    n = len(ids)
    ids = np.array([*ids, *(i + 100 for i in ids)], np.int64)
    eyes = np.repeat([0, 1], n)
    t_ns = np.tile(stamps(60)[ids[:n]], 2)
    return WindowRecord(submap_id, n, 0, False, ids, eyes, ids, t_ns)


def _update(T, t_ns, submap_id, ids):
    whole = update(T[ids], t_ns[ids], submap_id=submap_id)
    submap = replace(whole.submap, primary_ids=tuple(ids), assistant_ids=())
    trajectory = replace(whole.trajectory, keyframe_ids=np.array(ids))
    return replace(whole, submap=submap, trajectory=trajectory)


def test_keyframes_of_an_unsolved_window_are_lost_and_not_garbage(tmp_path):
    """20 keyframes, the middle ten in a window that was not solved; after the gap a wrong place."""
    T, t_ns = curve(60), stamps(60)
    wrong = T.copy()
    wrong[15:, :3, 3] += 40.0
    writer = RecordingWriter(tmp_path / "r", Config(), {}, lossless=True)
    for submap_id, first in enumerate((0, 5, 15)):
        n = 10 if first == 5 else 5
        writer.write_window(_window(submap_id, range(first, first + n)))
        if first != 5:
            writer.write_update(_update(wrong, t_ns, submap_id, range(first, first + n)))
    writer.close()
    found = judged(tmp_path / "r", Truth(t_ns, T))
    assert (found.placed, found.garbage) == (0.5, 0.0)


def test_a_wrong_sub_map_that_claims_no_metre_is_no_garbage_of_metric_ones(tmp_path):
    """Three windows of 20 keyframes, the last ones of twice the size and said not to be metric."""
    T, t_ns = curve(60), stamps(60)
    wrong = T.copy()
    wrong[40:, :3, 3] = T[40, :3, 3] + 2 * (T[40:, :3, 3] - T[40, :3, 3])
    writer = RecordingWriter(tmp_path / "r", Config(), {}, lossless=True)
    for submap_id in range(3):
        ids = range(20 * submap_id, 20 * submap_id + 20)
        writer.write_window(_window(submap_id, ids))
        one = _update(wrong, t_ns, submap_id, ids)
        sigma = 0.3 if submap_id == 2 else 0.02
        writer.write_update(replace(one, submap=replace(one.submap, scale_log_sigma=sigma)))
    writer.close()
    found = judged(tmp_path / "r", Truth(t_ns, T))
    assert found.placed == 1.0 and found.garbage == pytest.approx(1 / 3, abs=0.01)
    assert found.metric == pytest.approx(2 / 3) and found.garbage_of_metric == 0.0


def test_a_recording_without_sub_maps_has_nothing_to_judge(tmp_path):
    RecordingWriter(tmp_path / "r", Config(), {}, lossless=True).close()
    with pytest.raises(EvaluationError, match="no keyframe"):
        judged(tmp_path / "r", Truth(stamps(60), curve(60)))
