import pytest

from bench.__main__ import main
from bench.kilometres import drives, tables
from bench.kilometres.outcomes import Setting, Store, measure
from bench.kilometres.runs import Variant
from bench.kilometres.streams import Streams
from bench.tables import kept
from calm_edge.config import Config
from tests.bench.scripted.street_drive import street

needs_trajectories = pytest.mark.skipif(
    not drives.TRAJECTORIES.is_dir(), reason="no trajectories here"
)


@needs_trajectories
def test_a_stopped_run_goes_on_where_it_was(monkeypatch, tmp_path):
    monkeypatch.setattr(tables, "CACHE", tmp_path / "predictions")
    arguments = ["--sequences", "04", "--frames", "60", "--only", "ate,scale,focal"]
    arguments += ["--outcomes", str(tmp_path / "runs"), "--out", str(tmp_path / "eval")]
    assert main(["kilometres.tables", *arguments]) == 0
    made = kept(tmp_path / "eval")
    assert [t.name for t in made] == ["20_ate", "23_scale", "24_focal"]
    assert made[0].rows[0][0] == "04" and made[0].rows[0][3] > 0
    monkeypatch.setattr(tables, "measure", lambda *_: pytest.fail("run again"))
    assert main(["kilometres.tables", *arguments]) == 0
    assert kept(tmp_path / "eval") == made


@needs_trajectories
def test_without_time_nothing_is_run_and_that_is_said(tmp_path):
    arguments = ["--sequences", "04", "--only", "ate", "--minutes", "0"]
    arguments += ["--outcomes", str(tmp_path / "runs"), "--out", str(tmp_path / "eval")]
    assert main(["kilometres.tables", *arguments]) == 0
    (table,) = kept(tmp_path / "eval")
    assert table.rows == () and not any(check.passed for check in table.checks)
    assert any("not run (open): 04" in note for note in table.notes)


@pytest.mark.parametrize("arguments", [["--only", "speed"], ["--sequences", "11"]])
def test_what_is_unknown_is_one_line(arguments, capsys):
    assert main(["kilometres.tables", *arguments]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_a_crash_is_a_failed_run(tmp_path):
    def crashing(drive, backbone, config, loops):
        raise ZeroDivisionError("no baseline")

    drive = drives.cut("street", street(40), Config(), Streams(), 0)
    variant = Variant("crashing", aligner=crashing)
    one = measure(drive, "street", 1, None, Setting("open"), variant, None, Config())
    assert one.failed == "ZeroDivisionError: no baseline" and one.percent is None
    assert one.missing == one.n_keyframes == len(drive.keyframes)
    store = Store(tmp_path)
    store.put(one, "street", Setting("open"), variant)
    assert store.get("street", 1, Setting("open"), variant) == one
