import pytest

from bench.__main__ import main
from bench.mapping.quality import COLUMNS, against, table
from bench.mapping.rows import Quality
from calm_edge.evaluation.cloud import CloudError, Ghosts
from calm_edge.mapping.seams import SeamSummary

SEAMS = SeamSummary(3, 900, 0.2, 0.1, 0.6, 0.5)


def rows(sim3: CloudError | None, sl4: CloudError | None) -> list[Quality]:
    return [
        Quality("full", CloudError(0.3, 0.2, 0.25), SEAMS, "", Ghosts(3, 400)),
        Quality("Sim(3)", sim3, failed="" if sim3 else "sub-map 3 by 2: too few points"),
        Quality("SL(4)", sl4, failed="" if sl4 else "sub-map 5 by 4: not finite"),
    ]


def test_ours_must_be_nearer_by_every_figure():
    better, worse = CloudError(0.4, 0.4, 0.4), CloudError(0.6, 0.19, 0.4)
    first, second = against(rows(better, worse))
    assert first.measured == [0.75, 0.5, 0.625] and first.passed
    assert second.measured == [0.5, 1.053, 0.625] and not second.passed


def test_a_baseline_that_fails_is_beaten_and_its_row_says_why():
    made = table(rows(None, CloudError(1.0, 1.0, 1.0)), "drive", "command")
    assert [check.passed for check in made.checks] == [True, True]
    assert "too few points" in made.checks[0].measured
    assert made.rows[0] == ("full", 0.3, 0.2, 0.25, 0.1, 0.5, 3, 0.75)
    assert "too few points" in made.rows[1][0] and made.rows[1][1:] == (None,) * 7
    assert all(len(row) == len(COLUMNS) for row in made.rows)


def test_without_a_map_of_ours_nothing_is_kept():
    none = [Quality("full", None), *rows(None, None)[1:]]
    assert not any(check.passed for check in against(none))


@pytest.mark.parametrize("missing", ["recording", "truth"])
def test_bad_input_is_one_line(tmp_path, capsys, missing):
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "calib.txt").write_text("1 1 1 1 2 2\n1 1 1 1 2 2\n")
    truth = "nowhere" if missing == "truth" else "truth"
    arguments = [str(tmp_path / "recording"), "--truth", str(tmp_path / truth)]
    assert main(["mapping", *arguments]) == 1
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1 and str(tmp_path) in said[0]
