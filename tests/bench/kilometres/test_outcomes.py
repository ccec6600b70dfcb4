import dataclasses

import numpy as np
import pytest

from bench.kilometres import drives, outcomes, predictions, runs
from bench.kilometres.outcomes import OutcomeError, Setting, Store
from bench.kilometres.runs import Variant
from bench.kilometres.streams import Streams
from bench.scripted import ScriptedErrors
from calm_edge.config import Config
from tests.bench.kilometres.measured import focals, measured
from tests.bench.scripted.street_drive import street

OPEN, OURS = Setting("open"), Variant("ours")


@pytest.mark.parametrize("sigma", [0.01, None])
def test_what_was_kept_comes_back(tmp_path, sigma):
    one = measured(focals=focals(5.0, sigma))
    Store(tmp_path).put(one, "04", OPEN, OURS)
    assert Store(tmp_path).get("04", 1, OPEN, OURS) == one
    assert Store(tmp_path).get("04", 2, OPEN, OURS) is None


def test_other_settings_and_changes_are_other_runs(tmp_path):
    Store(tmp_path).put(measured(), "04", OPEN, OURS)
    looped = dataclasses.replace(OPEN, detection=0.5)
    changed = Variant("ours", {"scale": {"rectify": False}})
    assert Store(tmp_path).get("04", 1, looped, OURS) is None
    assert Store(tmp_path).get("04", 1, OPEN, changed) is None


def test_earlier_code_counts_only_when_asked(monkeypatch, tmp_path):
    Store(tmp_path).put(measured(), "04", OPEN, OURS)
    monkeypatch.setattr(outcomes, "_CODE", "changed since")
    assert Store(tmp_path).get("04", 1, OPEN, OURS) is None
    store = Store(tmp_path, stale=True)
    assert store.get("04", 1, OPEN, OURS) == measured() and store.earlier == 1
    assert store.get("03", 1, OPEN, OURS) is None and store.earlier == 1


def test_a_broken_file_is_named(tmp_path):
    Store(tmp_path).put(measured(), "04", OPEN, OURS)
    (file,) = tmp_path.glob("*.json")
    file.write_text("{}")
    with pytest.raises(OutcomeError, match=file.name):
        Store(tmp_path).get("04", 1, OPEN, OURS)


def test_a_run_is_measured_with_its_focals(tmp_path):
    drive = drives.cut("street", street(40, turn=0.02), Config(), Streams(), 0)
    dials = ScriptedErrors(coupled=True, focal_log_error=(0.05, 0.05))
    backbone = predictions.cached(drive, dials, tmp_path)
    one = outcomes.measure(drive, "street", 1, backbone, OPEN, OURS, None, Config())
    assert one.failed == "" and one.missing == 0 and one.focals is not None
    true = np.array([camera.fx for camera in drive.scene.cameras])
    np.testing.assert_allclose(one.focals.true, true)
    np.testing.assert_allclose(one.focals.raw, true * np.expm1(0.05), rtol=1e-6)
    np.testing.assert_allclose(one.focals.mean, true * np.exp(0.05), rtol=1e-6)
    seen = []
    runs.run(drive, backbone, OURS, inspect=seen.append)
    held = seen[0].intrinsics
    assert one.focals.held == tuple(held.focals) and one.focals.damping == tuple(held.damping)


def test_where_nothing_is_searched_there_are_no_focals(tmp_path):
    drive = drives.cut("street", street(40), Config(), Streams(), 0)
    backbone = predictions.cached(drive, ScriptedErrors(coupled=True), tmp_path)
    never = Variant("never", {"correction": {"apply": "never"}})
    one = outcomes.measure(drive, "street", 1, backbone, OPEN, never, None, Config())
    assert one.focals is None and one.ate_se3_m < 0.01
