import json
import math
from types import SimpleNamespace

import pytest

from bench.__main__ import main
from bench.drives import there
from bench.model import pipeline, pipeline_runs
from bench.model.pipeline import ate_table, time_table, worst_drive
from bench.model.pipeline_runs import INT8, NETWORK, PLAIN, TIMED
from calm_edge.backbones.base import BackboneError
from calm_edge.evaluation import EvaluationError
from calm_edge.recording.sequence_folder import SequenceFolder
from device.frame import Eye
from tests.replay.small_drive import write_drive

SCATTER = (0.98, 1.0, 1.02)


def results(share, of_int8=1.0):
    """Three drives and seeds; the network's errors relative to the others, one share a drive."""
    out = {}
    for number, name in enumerate(("a", "b", "c")):
        plain = {str(s): {"error_m": 1.0 + number} for s in range(3)}
        network = {str(s): {"error_m": share[number] * SCATTER[s]} for s in range(3)}
        for s in network.values():
            s["error_m"] *= 1.0 + number
        int8 = {
            s: {"error_m": f["error_m"] * of_int8 * SCATTER[-1 - int(s)]}
            for s, f in network.items()
        }
        out[name] = {PLAIN.name: plain, NETWORK.name: network, INT8.name: int8}
    return out


def kept(found):
    return {check.what: check.passed for check in ate_table(found).checks}


def test_a_network_that_halves_the_error_meets_every_requirement():
    passed = kept(results((0.5, 0.6, 0.5)))
    assert len(passed) == 3 and all(passed.values())


def test_one_drive_that_is_worse_is_named():
    found = results((0.3, 1.2, 0.3))
    (check,) = (c for c in ate_table(found).checks if c.what == "worst drive")
    assert not check.passed and check.measured.startswith("b: ")


def test_int8_that_costs_a_fifth_misses_its_requirement_alone():
    passed = kept(results((0.5, 0.5, 0.5), 1.2))
    assert not passed.pop("int8 over fp32") and all(passed.values())


def test_a_drive_that_only_the_network_loses_misses_the_requirement():
    found = results((0.5, 0.5, 0.5))
    found["c"][NETWORK.name]["1"] = {"error_m": None}
    passed = kept(found)
    assert not passed["worst drive"] and not passed["bundle:calm-geo over bundle"]


def test_the_worst_drive_is_counted_in_sigmas_of_the_seeds():
    reference = {(d, s): 1.0 for d in "ab" for s in (0, 1)}
    errors = {("a", 0): 1.0, ("a", 1): math.e**0.2, ("b", 0): 0.5, ("b", 1): 0.5}
    name, sigmas = worst_drive(errors, reference)
    # squares 2 * 0.1^2 over two degrees of freedom: a sigma of 0.1 a run
    assert name == "a" and sigmas == pytest.approx(math.sqrt(2))
    assert worst_drive({("a", 0): 2.0}, {("a", 0): 1.0}) is None


def test_skipped_drives_are_notes_and_failed_ones_count():
    found = results((0.5, 0.5, 0.5))
    for variant in (PLAIN, NETWORK):
        found.setdefault("gone", {})[variant.name] = {"0": {"skipped": "it is not here"}}
    found["a"][PLAIN.name]["0"] = {"failed": "exit 2"}
    made = ate_table(found)
    assert "gone skipped: it is not here" in made.notes
    assert f"a, {PLAIN.name} failed: seed 0: exit 2" in made.notes
    assert made.rows[0][made.columns.index("pairs")] == 8


def timed(seconds):
    return {
        "a": {
            v.name: {"0": {"windows_s": [{"infer": s, "place": 0.1, "densify": 1.0}]}}
            for v, s in zip(TIMED, seconds, strict=True)
        }
    }


@pytest.mark.parametrize(("infer_s", "passed"), [(0.6, True), (0.8, False)])
def test_a_window_s_time_is_all_but_its_depth(infer_s, passed):
    made = time_table(timed((2.0, infer_s)))
    assert [c.passed for c in made.checks] == [passed, True]
    totals = [row[2] for row in made.rows if row[1] == "all but depth"]
    assert totals == pytest.approx([2.1, infer_s + 0.1])


def test_every_run_is_kept_and_a_later_one_adds(tmp_path, monkeypatch):
    asked = []

    def run(drive, variant, seed, out):
        asked.append((drive.name, variant.name, seed))
        return {"error_m": 1.0 + seed, "windows_s": []}

    monkeypatch.setattr(pipeline_runs, "run", run)
    drives = [pipeline_runs.DRIVES[name] for name in ("kitti06", "demo")]
    pipeline_runs.run_all(drives[:1], (PLAIN, NETWORK), 2, tmp_path)
    found = pipeline_runs.run_all(drives[1:], (PLAIN,), 1, tmp_path)
    assert asked[:2] == [("kitti06", PLAIN.name, 0), ("kitti06", NETWORK.name, 0)]
    assert pipeline_runs.errors(found, PLAIN) == {
        ("kitti06", 0): 1.0,
        ("kitti06", 1): 2.0,
        ("demo", 0): 1.0,
    }
    assert json.loads((tmp_path / pipeline_runs.RESULTS).read_text()) == found


def test_variants_say_everything_that_tells_them_apart():
    assert INT8.options(3) == (
        *("--pace", "lockstep", "--set", "backbone.name=bundle:calm-geo"),
        *("--set", "backbone.precision=int8", "--set", "backbone.seed=3"),
    )


def test_without_the_model_nothing_is_run(monkeypatch, capsys, tmp_path):
    def refused(config):
        raise BackboneError("no model calm-geo")

    monkeypatch.setattr(pipeline, "opened", refused)
    assert main(["model.pipeline", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().err == "skipped: no model calm-geo\n"


def test_windows_are_timed_once_whole_and_after_the_first():
    def update(number, primary, infer_ms):
        submap = SimpleNamespace(id=number, n_primary=primary, assistant_ids=range(15))
        return SimpleNamespace(submap=submap, stage_ms={"infer": infer_ms})

    updates = [update(0, 15, 9000.0), update(1, 15, 500.0), update(1, 15, 20.0), update(2, 7, 1.0)]
    assert pipeline_runs.full_windows_s(updates, 15) == [{"infer": 0.5}]


def test_a_seed_is_a_drive_of_its_own_and_the_same_for_every_variant(tmp_path, monkeypatch):
    source = write_drive(tmp_path / "drive", 40)
    played = []

    def record(sequence, out, options):
        folder = SequenceFolder(sequence)
        played.append([tuple(folder.t_ns(eye).tolist()) for eye in Eye])
        raise EvaluationError("seen enough")

    monkeypatch.setattr(pipeline_runs.steps, "record", record)
    drive = pipeline_runs.Drive("small", there(source), ())
    for seed in (0, 1, 2):
        for variant in (PLAIN, NETWORK):
            found = pipeline_runs.run(drive, variant, seed, tmp_path)
            assert found == {"failed": "seen enough"}
    assert played[0::2] == played[1::2]
    whole, one, other = played[0::2]
    assert [len(t_ns) for t_ns in whole] == [40, 40] and one != other
    assert all(set(t) <= set(w) for lost in (one, other) for t, w in zip(lost, whole, strict=True))
